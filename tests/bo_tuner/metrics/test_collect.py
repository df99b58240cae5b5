"""From what nodes say to metrics: nothing but a finite number ever becomes one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner import maxima
from bo_tuner.metrics.collect import LARGEST_METRIC, Collector
from bo_tuner.trials import EvaluationState

OK = {"status": "ok", "reason": ""}


def judge(make_study, **said):
    return Collector(make_study()).outcome(said)


@pytest.mark.parametrize("value", [0.25, "0.25", "2.5e-1", " 0.25 "])
def test_numbers_and_their_text(make_study, value):
    found = judge(make_study, axis=OK | {"error": value, "peak": 3})
    assert found.state is EvaluationState.COMPLETE
    assert found.metrics == {"error": 0.25, "peak": 3.0}
    assert found.reason == ""


@pytest.mark.parametrize(
    "value",
    [
        *("nan", "inf", "-inf", float("nan"), float("inf"), "", "fast", None, [1.0], "0x10"),
        *(True, 2e90, -2e90, "1e101", "1" + 200 * "0", 10**400),
    ],
)
def test_anything_else_fails_the_evaluation_and_names_the_metric(make_study, value):
    found = judge(make_study, axis=OK | {"error": 0.25, "peak": value})
    assert found.state is EvaluationState.FAILED
    assert found.metrics == {}
    assert found.reason.startswith("axis: metric peak is ")


def test_a_missing_metric(make_study):
    found = judge(make_study, axis=OK | {"error": 0.25})
    assert found.state is EvaluationState.FAILED
    assert found.reason == "axis: metric peak is missing"
    found = judge(make_study, axis=OK | {"error": 0.25, "peek": 1.0})
    assert found.reason == "axis: metric peak is missing; did you mean 'peek'?"


def test_the_largest_number_is_one_that_the_models_take(make_study):
    found = judge(make_study, axis=OK | {"error": LARGEST_METRIC, "peak": -LARGEST_METRIC})
    assert found.state is EvaluationState.COMPLETE
    assert LARGEST_METRIC < maxima.RESPONSE
    beyond = judge(make_study, axis=OK | {"error": 1e120, "peak": 1.0})
    assert beyond.reason == "axis: metric error is 1e+120, beyond 1e+90"


ASSIGNED = {"gain": 0.1 + 0.2, "count": 2**62 + 1, "mode": "up", "on": True, "levels": [1.0, 2.0]}


@pytest.mark.parametrize(
    "reported",
    [
        {"gain": repr(0.1 + 0.2), "count": str(2**62 + 1), "mode": "up", "on": "True"},
        {"gain": 0.1 + 0.2, "count": 2**62 + 1, "on": "true", "levels": "whatever"},
        {"count": f"{2**62 + 1}", "other": "5"},
        {"gain": str(float(np.float32(0.1 + 0.2)))},
    ],
)
def test_parameters_that_a_node_reports_as_they_were_set(make_study, reported):
    result = {"axis": OK | {"error": 0.25, "peak": 1} | reported}
    found = Collector(make_study()).outcome(result, {"axis": ASSIGNED})
    assert found.state is EvaluationState.COMPLETE


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("gain", "0.3"), ("gain", 0.3), ("gain", "high"), ("count", str(2**62)),
        ("count", float(2**62)), ("mode", "down"), ("on", "false"), ("on", 1), ("gain", None),
    ],
)  # fmt: skip
def test_a_node_that_ran_with_another_parameter(make_study, name, reported):
    """Whatever else it says: what it failed with is none of what was planned either."""
    for status in (OK, {"status": "failed", "reason": "stalled"}):
        said = {"axis": status | {"error": 0.25, "peak": 1, name: reported}}
        found = Collector(make_study()).outcome(said, {"axis": ASSIGNED})
        assert found.state is EvaluationState.FAILED
        expected = f"axis: ran with parameter {name} {reported}, expected {ASSIGNED[name]}"
        assert found.reason == expected


def test_a_metric_may_have_the_name_of_a_parameter(make_study):
    said = {"axis": OK | {"error": 0.25, "peak": 1}}
    found = Collector(make_study()).outcome(said, {"axis": {"error": 3.0}})
    assert found.metrics == {"error": 0.25, "peak": 1.0}


@given(value=st.text(max_size=12) | st.floats().map(repr))
def test_what_is_complete_is_finite(make_study, value):
    found = judge(make_study, axis=OK | {"error": value, "peak": 1.0})
    assert (found.state is EvaluationState.COMPLETE) == (found.metrics != {})
    assert all(math.isfinite(number) for number in found.metrics.values())


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ({"status": "failed", "reason": "diverged"}, "axis: diverged"),
        ({"status": "failed", "reason": ""}, "axis: no reason given"),
        ({"status": "failed"}, "axis: no reason given"),
        ({}, "axis: no reason given"),
    ],
)
def test_a_failed_node_fails_the_evaluation_whatever_its_figures(make_study, said, reason):
    found = judge(make_study, axis=said | {"error": 0.25, "peak": 1.0})
    assert found.state is EvaluationState.FAILED
    assert found.reason == reason
    assert found.metrics == {}


def test_what_others_did_is_not_held_against_the_parameters(make_study):
    for status in ("failed", "disturbed"):
        found = judge(make_study, axis={"status": status, "reason": "two commands"})
        assert found.state is EvaluationState.FAILED
        assert found.reason == "axis: two commands"
        assert found.unusable is (status == "disturbed")


def test_all_that_was_said_is_kept(make_study):
    found = judge(make_study, axis=OK | {"error": 0.25, "peak": 1, "note": "x"}, other={"a": 2.0})
    assert found.details["axis.note"] == "x"
    assert found.details["axis.error"] == "0.25"
    assert found.reason == "other: no reason given"


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_an_objective_without_a_logarithm(make_study, value):
    study = make_study(objective={"metric": "error", "scale": "log"})
    found = Collector(study).outcome({"axis": OK | {"error": value, "peak": 1.0}})
    assert found.state is EvaluationState.FAILED
    assert found.reason == f"metric error is {value}; its log scale needs a positive value"
    assert found.details["axis.peak"] == "1.0"


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_limited_metric_without_a_logarithm(make_study, value):
    node = {"node": "axis"}
    study = make_study(metrics={"error": node, "peak": node | {"scale": "log"}})
    found = Collector(study).outcome({"axis": OK | {"error": 1.0, "peak": value}})
    assert found.state is EvaluationState.FAILED
    assert found.reason == f"metric peak is {value}; its log scale needs a positive value"


@pytest.mark.parametrize("value", ["inf", "-inf", "nan"])
def test_an_infinite_metric_with_a_log_scale(make_study, value):
    node = {"node": "axis"}
    study = make_study(metrics={"error": node, "peak": node | {"scale": "log"}})
    found = Collector(study).outcome({"axis": OK | {"error": 1.0, "peak": value}})
    assert found.state is EvaluationState.FAILED
    assert found.reason == f"axis: metric peak is {value}"


def test_a_metric_under_another_key(make_study):
    node = {"node": "axis"}
    study = make_study(metrics={"error": node | {"key": "error_p99"}, "peak": node})
    found = Collector(study).outcome({"axis": OK | {"error_p99": 2.0, "peak": 1.0, "error": 5.0}})
    assert found.metrics == {"error": 2.0, "peak": 1.0}
