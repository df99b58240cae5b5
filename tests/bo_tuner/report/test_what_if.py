"""Sliders over the predictions: what they say is what the models say, and where it says nothing."""

import shlex

import numpy as np
import pytest
from functions import NODE
from report_runs import with_ends

from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.what_if import BLIND, LIKELY, NOT_PERMITTED, forecast, what_if

PAIR = {
    name: NODE | {"type": "double", "bounds": [0.0, 1.0], "default": default}
    for name, default in (("gain", 0.6), ("ends", 0.8))
}


@pytest.fixture(scope="module")
def axis(axis_run):
    return Analysis(axis_run())


@pytest.fixture(scope="module")
def pair(axis_run):
    """Two parameters of which the first must be the smaller one."""
    return Analysis(axis_run(parameters=PAIR, order=[["gain", "ends"]]))


def numbers(text):
    """Mean and both ends of a prediction, such as ``1.2 (1.1 to 1.4)``."""
    mean, _, band = text.partition(" (")
    return [float(mean), *map(float, band.rstrip(")").split(" to "))]


def test_a_set_can_be_tried_by_a_command(axis):
    command = what_if(axis).command
    assert shlex.split(command)[:2] == ["try", str(axis.record.path.resolve() / "study.yaml")]


def test_along_a_slider_it_says_what_the_models_say(axis):
    sliders = what_if(axis)
    (gain,), (along,) = sliders.sliders, sliders.along
    assert (gain.name, len(gain.values), len(along)) == ("gain", len(gain.words), len(gain.values))
    # The bounds are 0 and 1, so that a value is its place in the unit cube.
    points = np.array(gain.values)[:, None]
    mean, variance = axis.models.objective.predict(points)
    half = 2.0 * np.sqrt(variance)
    expected = axis.study.objective.from_cost(np.column_stack([mean, mean - half, mean + half]))
    told = np.array([numbers(each.cells[0]) for each in along])
    np.testing.assert_allclose(told, expected, rtol=1e-3, atol=1e-6)
    (limit,) = axis.models.constraints.values()
    told = np.array([numbers(each.cells[1]) for each in along])
    np.testing.assert_allclose(told, np.column_stack(limit.band(points, 2.0)), rtol=1e-3, atol=1e-4)
    assert sliders.rows[-1] == (LIKELY, "")
    likely = axis.models.feasibility(points) >= BELIEVED_FEASIBLE
    percents = [each.cells[-1].removesuffix(" %").rpartition(" ")[2] for each in along]
    assert [float(text) >= 100.0 * BELIEVED_FEASIBLE for text in percents] == likely.tolist()


def test_it_begins_where_the_answer_is(axis):
    sliders = what_if(axis)
    (gain,) = sliders.sliders
    assert gain.values[gain.place] == axis.answer.parameters["gain"]
    assert gain.values == sorted(gain.values)
    assert forecast(axis, {}) == sliders.along[0][gain.place]
    assert forecast(axis, {"gain": gain.values[3]}) == sliders.along[0][3]


@pytest.mark.parametrize("values", [{"gain": 1.01}, {"load": 1.0}, {"gain": float("nan")}])
def test_what_is_no_value_of_a_tuned_number_has_no_forecast(axis, values):
    assert forecast(axis, values) is None


def test_together_two_values_are_another_point_than_each_by_itself(pair):
    first, second = (slider.values[9] for slider in what_if(pair).sliders)
    point = np.array([[first, second]])
    mean = pair.study.objective.from_cost(pair.models.objective.predict_mean(point))[0]
    told = forecast(pair, {"gain": first, "ends": second}).cells[0]
    assert numbers(told)[0] == pytest.approx(mean, rel=1e-3)


def test_what_is_not_permitted_is_said(pair):
    assert forecast(pair, {"gain": 0.9, "ends": 0.2}).remark == NOT_PERMITTED
    assert forecast(pair, {}).remark == ""


def test_where_trials_failed_the_models_say_nothing(axis_run):
    analysis = Analysis(axis_run(**with_ends(0.6)))
    assert forecast(analysis, {"gain": 1.0}).remark == BLIND
    assert forecast(analysis, {}).remark == ""
