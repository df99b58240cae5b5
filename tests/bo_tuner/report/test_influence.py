"""Influence of each parameter, against functions whose total indices are known."""

import dataclasses

import numpy as np
import pytest
from functions import FunctionBackend, make_study
from made_runs import make_run

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.influence import influence

TUNED = {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}


@pytest.fixture
def section_of(tmp_path):
    """Function that makes the section of a run on a function of a, b and c."""

    def make(function, trials=25, parameters=("a", "b", "c")):
        study = make_study(
            parameters=dict.fromkeys(parameters, TUNED),
            constraints=None,
            budget={"trials": trials, "initial_trials": trials, "drawn_contexts": 2,
                    "search_evaluations": 1, "validation_draws": 2},
        )  # fmt: skip
        run = make_run(tmp_path / "run", study, FunctionBackend(study, function))
        return influence(Analysis(run))

    return make


def indices(section):
    (table,) = section.tables
    return {row[0]: [float(v) for v in row[1:]] for row in table.rows if "–" not in row}


def test_a_sum_of_two_terms(section_of):
    """Of 2 a + b the variances are 4/12 and 1/12: the shares are 0.8 and 0.2."""
    section = section_of(lambda a, b, c, **_: {"error": 2.0 * a + b, "peak": 1.0 + c})
    found = indices(section)
    np.testing.assert_allclose(found["mean error"], [0.8, 0.2, 0.0], atol=0.05)
    np.testing.assert_allclose(found["mean peak"], [0.0, 0.0, 1.0], atol=0.05)
    assert "mean error: most by a." in section.lead
    assert "mean peak: most by c." in section.lead


def test_an_interaction_counts_for_both(section_of):
    """Of (a - 1/2)(b - 1/2) all variance is that of the interaction."""
    section = section_of(
        lambda a, b, c, **_: {"error": 1.0 + (a - 0.5) * (b - 0.5), "peak": 1.0}, trials=40
    )
    found = indices(section)
    np.testing.assert_allclose(found["mean error"], [1.0, 1.0, 0.0], atol=0.1)
    # A constant has no variance to explain, and no panel.
    assert "mean peak" not in found
    assert [panel.title for panel in section.figures[0].panels] == ["mean error"]


def test_too_few_trials_and_a_single_parameter_have_none(section_of, analysis):
    assert section_of(lambda **values: {"error": values["a"], "peak": 0.1}, trials=14) is None
    assert len(analysis.study.search_space().names) == 1
    assert influence(dataclasses.replace(analysis)) is None
