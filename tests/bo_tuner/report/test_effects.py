"""What each parameter does, against functions whose total indices are known."""

import dataclasses

import numpy as np
import pytest
from functions import FunctionBackend, make_study
from made_runs import make_run

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.effects import effects

TUNED = {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}


@pytest.fixture
def section_of(tmp_path):
    """Function that makes the section of a run on a function of a, b and c."""

    def make(function, trials=25, parameters=("a", "b", "c"), *, quick=False):
        study = make_study(
            parameters=dict.fromkeys(parameters, TUNED),
            constraints=None,
            budget={"trials": trials, "initial_trials": trials, "drawn_contexts": 2,
                    "search_evaluations": 1, "validation_draws": 2},
        )  # fmt: skip
        run = make_run(tmp_path / "run", study, FunctionBackend(study, function))
        return effects(Analysis(run, quick=quick))

    return make


def indices(section):
    """The shares of each response, in the order of the parameters."""
    return {
        panel.title: [float(y) for bars in panel.elements for y in bars.y]
        for figure in section.figures
        for panel in figure.panels
    }


def test_a_sum_of_two_terms(section_of):
    """Of 2 a + b the variances are 4/12 and 1/12: the shares are 0.8 and 0.2."""
    section = section_of(lambda a, b, c, **_: {"error": 2.0 * a + b, "peak": 1.0 + c})
    found = indices(section)
    np.testing.assert_allclose(found["mean error"], [0.8, 0.2, 0.0], atol=0.05)
    np.testing.assert_allclose(found["mean peak"], [0.0, 0.0, 1.0], atol=0.05)


def test_an_interaction_counts_for_both(section_of):
    """Of (a - 1/2)(b - 1/2) all variance is that of the interaction."""
    section = section_of(
        lambda a, b, c, **_: {"error": 1.0 + (a - 0.5) * (b - 0.5), "peak": 1.0}, trials=40
    )
    found = indices(section)
    np.testing.assert_allclose(found["mean error"], [1.0, 1.0, 0.0], atol=0.1)
    # A constant has no variance to explain, and no panel.
    assert list(found) == ["mean error"]


def test_too_few_trials_and_a_single_parameter_have_no_shares(section_of, analysis):
    few = section_of(lambda **values: {"error": values["a"], "peak": 0.1}, trials=14)
    assert indices(few) == {}
    assert len(analysis.study.search_space().names) == 1
    assert indices(effects(dataclasses.replace(analysis))) == {}


def test_what_takes_long_is_left_out_while_the_run_goes_on(section_of):
    section = section_of(lambda a, b, c, **_: {"error": 2.0 * a + b, "peak": 1.0 + c}, quick=True)
    assert indices(section) == {}
    assert [row[0] for row in section.tables[0].rows] == ["a", "b", "c"]
