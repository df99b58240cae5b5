"""Metrics that are computed from other metrics."""

import numpy as np
import pytest
from signal_runs import outcome_of, signal_study

from bo_tuner.errors import StudyError
from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml
from bo_tuner.trials import EvaluationState

# The angle is 1 for 2 s, from the start on, and then 3 for 1 s; the setpoint is 2 throughout.
RECORDING = Recording(
    {
        "angle": RecordedSignal(np.array([-0.5, 2.0]), np.array([1.0, 3.0])),
        "setpoint": RecordedSignal(np.array([-0.5, 1.0]), np.array([2.0, 2.0])),
    },
    end=3.0,
)
ERROR = {"of": "setpoint - angle", "measure": "iae", "unit": "rad s"}
EFFORT = {"of": "angle", "measure": "total_variation", "unit": "rad"}


def study(objective="error + 0.25 * effort", **metrics):
    metrics = {"error": ERROR, "effort": EFFORT} | metrics
    return study_from_mapping(signal_study(metrics=metrics, objective=objective))


def test_an_objective_of_text_is_a_metric_of_its_own():
    """The parts are there, too."""
    made = study()
    found = outcome_of(made, RECORDING)
    assert found.metrics == {"error": 3.0, "effort": 2.0, "cost": 3.0 + 0.25 * 2.0}
    assert made.objective.metric == "cost"
    assert made.objective.direction == "minimize"


def test_an_objective_of_text_may_be_the_name_of_a_metric():
    assert study("effort") == study({"metric": "effort"})


def test_what_is_written_reads_back_equal():
    made = study()
    again = parse_study(study_to_yaml(made))
    assert again == made
    assert outcome_of(again, RECORDING) == outcome_of(made, RECORDING)


def test_the_order_of_the_study_does_not_matter():
    metrics = {"sum": {"expression": "error + effort"}, "error": ERROR, "effort": EFFORT}
    made = study_from_mapping(signal_study(metrics=metrics, objective={"metric": "sum"}))
    assert list(outcome_of(made, RECORDING).metrics.items()) == [
        ("sum", 5.0), ("error", 3.0), ("effort", 2.0),
    ]  # fmt: skip


def test_of_reported_metrics(make_study):
    """A limit is on it as on any other."""
    metrics = {
        "error": {"node": "axis", "reproducible": False},
        "peak": {"node": "axis"},
        "both": {"expression": "hypot(error, peak)"},
    }
    limit = {"kind": "chance", "metric": "both", "upper": 5.5, "probability": 0.9}
    made = make_study(metrics=metrics, constraints={"both": limit})
    said = {"axis": {"status": "ok", "error": 3.0, "peak": "4.0"}}
    assert Collector(made).outcome(said).metrics["both"] == 5.0
    assert not made.metrics["both"].reproducible
    assert made.metrics["both"].measures_time


@pytest.mark.parametrize(
    ("expression", "reason"),
    [("error / (effort - 2)", "metric cost is inf"), ("log(effort - 2.5)", "metric cost is nan")],
)
def test_an_undefined_value_fails_the_run_by_name(expression, reason):
    found = outcome_of(study(expression), RECORDING)
    assert (found.state, found.reason) == (EvaluationState.FAILED, reason)


@pytest.mark.parametrize(
    ("expression", "unit"),
    [
        ("error + 0.01 * other", "rad s"),
        ("max(error, other) - 2 * abs(other)", "rad s"),
        ("hypot(error, other)", "rad s"),
        ("error * other / (error + other)", "rad s"),
        ("error * other", ""),
        ("error + 1", ""),
        ("log(error)", ""),
        ("error + effort", ""),
        ("error / other", ""),
    ],
)
def test_the_unit_is_that_of_the_parts_where_the_expression_keeps_it(expression, unit):
    other = {"of": "angle", "measure": "iae", "unit": "rad s"}
    assert study(expression, other=other).metrics["cost"].unit == unit
    given = study("error", other=other, own={"expression": expression, "unit": "points"})
    assert given.metrics["own"].unit == "points"


@pytest.mark.parametrize(
    ("objective", "metrics", "problem"),
    [
        ("eror", {}, "objective.metric: there is no metric 'eror'; did you mean 'error'?"),
        ("eror + 1", {}, "objective: there is no metric or function 'eror'; did you mean 'error'?"),
        ("error +", {}, "objective: not an expression"),
        ("1 + 1", {}, "objective: expected an expression with a metric"),
        ("error + 1", {"cost": EFFORT}, "objective: an expression is the metric 'cost', which"),
        ("error", {"own": {"expression": "angle + 1"}},
         "metrics.own.expression: there is no metric or function 'angle'"),
        ("error", {"own": {"expression": "own + 1"}},
         "metrics.own.expression: there is no metric or function 'own'"),
    ],
)  # fmt: skip
def test_what_is_no_expression_of_metrics(objective, metrics, problem):
    with pytest.raises(StudyError) as caught:
        study(objective, **metrics)
    assert str(caught.value).startswith(problem)
