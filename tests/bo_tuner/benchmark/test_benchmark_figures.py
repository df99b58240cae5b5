import numpy as np
import pytest

from bo_tuner.benchmark import figures
from bo_tuner.benchmark.calibration import calibrate
from bo_tuner.benchmark.cost import cost_of_run
from bo_tuner.benchmark.experiment import Experiment
from bo_tuner.benchmark.experiment_parts import Calibration, Cost, Row, SurrogateFigure
from bo_tuner.benchmark.field_figure import field_figure
from bo_tuner.benchmark.fields import axes, surrogate_fields, true_fields
from bo_tuner.benchmark.runs import RunSize
from bo_tuner.benchmark.summary import summarise
from bo_tuner.figures.elements import Contour, Heatmap, Line, Points
from bo_tuner.study_file import load_study

JUDGE = "valley:Judge"


def drawn(panel, kind):
    return [element for element in panel.elements if isinstance(element, kind)]


def test_convergence_shows_means_of_the_feasible(make_case, record, answer):
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=2)
    incumbents = {
        "1": {"objective": 3.0, "feasible": True}, "2": {"objective": 1.0, "feasible": False}
    }  # fmt: skip
    way = [[(20, 1)], [(20, 1), (60, 2)]]
    done = {f"run/c/A/{s + 1}": record(answer(), way[s], incumbents) for s in (0, 1)}
    done["run/c/A/1"]["result"]["incumbents"]["1"] = {"objective": 2.0, "feasible": True}
    done["run/c/A/2"]["result"]["incumbents"] = {
        "1": {"objective": 4.0, "feasible": True}, "2": incumbents["2"]
    }  # fmt: skip
    figure = figures.convergence(case, [summarise(case, case.rows["A"], done, None)], None)
    (quality,), (share,) = drawn(figure.panels[0], Line), drawn(figure.panels[1], Line)

    def at(line, cuts):
        return line.y[np.searchsorted(line.x, cuts)]

    assert np.isnan(at(quality, 5))
    assert (at(quality, 30), at(quality, 80)) == (3.0, 2.0)
    assert (at(share, 5), at(share, 30), at(share, 80)) == (0.0, 1.0, 0.5)


@pytest.fixture(scope="module")
def fields(study):
    size = RunSize(40, 0, 4)
    row = Row(name="IV", algorithm="IV")
    believed = surrogate_fields(study, row, 1, size, 4)
    truth = [true_fields(study, JUDGE, 4, first) for first in axes(study, 4)[0]]
    return believed, truth


def test_the_true_field_is_the_closed_form(study, fields):
    values = axes(study, 4)[0]
    _, truth = fields
    for i, first in enumerate(values):
        for j, second in enumerate(values):
            assert truth[i]["worst"][j] == pytest.approx(0.6 * (first + second), abs=1e-5)


def test_fields_stand_upright(make_case, study, fields):
    """The second parameter runs upwards: rows of a heatmap are its values."""
    case = make_case(
        rows={"IV": Row(name="IV", algorithm="IV")},
        surrogates=SurrogateFigure(row="IV", points=4),
    )
    believed, truth = fields
    figure = field_figure(case, believed, truth)
    titles = [panel.title for panel in figure.panels]
    assert titles == [
        "error, surrogate", "error, truth", "peak, surrogate", "peak, truth",
        "believed probabilities", "feasible in truth",
    ]  # fmt: skip
    assert figure.columns == 2
    worst = next(p for p in figure.panels if p.title == "peak, truth")
    (heat,) = drawn(worst, Heatmap)
    assert heat.z[3][0] == truth[0]["worst"][3]
    (contour,) = [c for c in drawn(worst, Contour) if c.name == "feasible in truth"]
    assert contour.z[0][0] == 1.0
    assert contour.z[3][3] == 0.0
    surrogate = figure.panels[0]
    assert sum(len(points.x) for points in drawn(surrogate, Points)) == len(
        believed["samples"]
    ) + len(("default", "answer"))


def test_calibration_compares_what_the_study_permits():
    given = Calibration(
        study=load_study("full"),
        metric="return_time",
        node="controller",
        parameter="return_time",
        modelled="modelled",
        measured="measured",
        grid={"control_horizon": (2, 8), "prediction_horizon": (4, 8)},
        repeats=1,
    )
    result = calibrate(given)
    horizons = [tuple(p["parameters"].values())[:2] for p in result["points"]]
    # Eight moves in a horizon of four are not permitted.
    assert horizons == [(2, 4), (2, 8), (8, 8)]
    assert all(point["modelled"] > 0 for point in result["points"])
    longer = {h: p["modelled"] for h, p in zip(horizons, result["points"], strict=True)}
    assert longer[8, 8] > longer[2, 8]


def test_calibration_fits_a_line(make_case):
    given = Calibration(
        study=load_study("full"), metric="return_time", node="controller",
        parameter="return_time", modelled="modelled", measured="measured", grid={}, repeats=2,
    )  # fmt: skip
    experiment = Experiment(
        name="e", judge="valley:Judge", cases={"c": make_case()}, calibration=given
    )
    points = [{"modelled": x, "measured": [1.0 + 0.25 * x, 9.0]} for x in (1.0, 2.0, 4.0)]
    points.append({"modelled": None, "measured": [1.0]})
    _, text = figures.calibration(experiment, {"points": points})
    assert text.startswith("Measured = 1 s + 0.25 × modelled, over 3 settings; correlation 1.000.")
    assert "4.0 times as long" in text


def test_cost_grows_by_the_power_that_was_put_in(make_case):
    cost = Cost(dimensions=(2, 4), trials=(50, 100), compared_trials=100, seeds=1)
    experiment = Experiment(name="e", judge="valley:Judge", cases={"c": make_case()}, cost=cost)
    done = {
        "cost/2/1": {"result": {"trials": [50, 100], "seconds": [1.0, 4.0]}},
        "cost/4/1": {"result": {"trials": [100], "seconds": [8.0]}},
    }
    figure, text = figures.cost_scaling(experiment, done)
    assert "with the trials to the power 2.00" in text
    assert "with the parameters to the power 1.00" in text
    assert len(figure.panels) == 2


def test_cost_is_taken_at_the_marks():
    result = cost_of_run("IV", 3, 1, [4, 22])
    assert result["trials"] == [4, 22]
    assert 0.0 < result["seconds"][0] < result["seconds"][1]
