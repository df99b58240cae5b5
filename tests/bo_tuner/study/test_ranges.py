"""Declared ranges of metrics: what is refused, and what a run outside is told as."""

import dataclasses

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study.metrics import RelativeMetric, ReportedMetric
from bo_tuner.study.ranges import OutOfRange, outside
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

FREE = {"certificate": {"distribution_free": True}}


def metrics(**peak):
    return {"error": {"node": "axis"}, "peak": {"node": "axis"} | peak}


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ([0.0], "expected two numbers, as [low, high]"),
        ([1.0, 1.0], "expected low < high, found [1, 1]"),
        ([2.0, 1.0], "expected low < high, found [2, 1]"),
        ([0.0, float("inf")], "expected a finite number"),
        ("wide", "expected two numbers"),
    ],
)
def test_no_range(found, told):
    with pytest.raises(StudyError) as error:
        ReportedMetric(name="peak", node="axis", range=found)
    assert told in str(error.value)


@pytest.mark.parametrize(
    ("declared", "certain"),
    [([1.0, 2.0], "keep"), ([-1.0, 1.0], "break"), ([2.0, 3.0], "keep"), ([0.0, 0.5], "break")],
)
def test_a_limit_that_the_range_decides(make_study, declared, certain):
    """The limit of this study is an upper one of 1."""
    with pytest.raises(StudyError, match=f"no run can {certain} it: expected a limit inside") as e:
        make_study(metrics=metrics(range=declared))
    assert e.value.path == ("constraints", "peak", "upper")
    assert make_study(metrics=metrics(range=[0.0, 2.0])).metrics["peak"].range == (0.0, 2.0)


@pytest.mark.parametrize(("side", "certain"), [("lower", "break"), ("upper", "keep")])
def test_one_of_two_limits_has_the_key_of_the_file(make_study, side, certain):
    limits = {"lower": 1.0, "upper": 3.0} | {side: 0.0 if side == "lower" else 1.5}
    declared = [0.0, 2.0] if side == "lower" else [1.5, 4.0]
    constraint = {"kind": "worst_case", "metric": "peak"} | limits
    with pytest.raises(StudyError) as error:
        make_study(metrics=metrics(range=declared), constraints={"band": constraint})
    found = [error.value, *error.value.others]
    assert ("constraints", "band", side) in [item.path for item in found]
    assert any(f"no run can {certain} it" in item.problem for item in found)


def test_a_difference_to_the_default_has_the_range_that_follows():
    part = ReportedMetric(name="peak", node="axis", range=(0.0, 2.0))
    assert RelativeMetric(name="gain", relative="peak", factor=1.5).joined(
        {"peak": part}
    ).range == (-3.0, 2.0)


def test_free_of_assumptions_a_mean_needs_a_range(make_study):
    with pytest.raises(StudyError, match="constraint peak limits a mean") as error:
        make_study(**FREE)
    assert error.value.path == ("certificate", "distribution_free")
    assert make_study(**FREE, metrics=metrics(range=[0.0, 2.0])).certificate.distribution_free


def test_a_run_outside_is_a_fault_of_the_declaration(make_study):
    study = make_study(metrics=metrics(range=[0.0, 2.0]))
    runs = [
        Evaluation(
            0,
            k,
            Stage.VALIDATION,
            {"gain": 0.5},
            {"load": 1.0},
            k,
            Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": peak}),
        )
        for k, peak in enumerate([0.0, 2.0, 2.1])
    ]
    assert outside(study.metrics, runs[:2]) is None
    assert outside(study.metrics, runs) == OutOfRange("peak", 2.1, 0.0, 2.0)
    failed = dataclasses.replace(runs[2], outcome=Outcome(EvaluationState.FAILED, reason="stalled"))
    assert outside(study.metrics, [failed]) is None
