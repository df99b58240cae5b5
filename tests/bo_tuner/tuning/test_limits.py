"""Whether a limit holds: one rule for all that use it."""

from dataclasses import replace

import numpy as np
import pytest
from functions import planned
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from bo_tuner.trials import EvaluationState, Outcome, Stage
from bo_tuner.tuning import recommendation
from bo_tuner.tuning.limits import judge_sample, most_violations, refuted, violated
from bo_tuner.tuning.recommendation import with_check
from bo_tuner.tuning.validation import validate

CHANCE = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}


def chance(make_study, probability):
    study = make_study(constraints={"peak": CHANCE | {"probability": probability}})
    return study.constraints["peak"]


@given(percent=st.integers(50, 99), hundreds=st.integers(1, 50))
def test_a_share_that_is_allowed_exactly_holds(make_study, percent, hundreds):
    """Of 100 draws, exactly 100 - percent may violate the limit, despite rounding."""
    constraint = chance(make_study, percent / 100.0)
    assert most_violations(constraint, 100 * hundreds) == (100 - percent) * hundreds


def test_confirmation_validation_and_record_judge_the_same_values_alike(
    make_study, make_trial, function_backend
):
    """With probability 0.9, two violations of twenty are what is allowed."""
    study = make_study(constraints={"peak": CHANCE}).replace(
        trials=1, drawn_contexts=10, search_evaluations=0, validation_draws=20
    )
    peaks = [1.5, 1.5] + [0.5] * 18

    drawn = [planned({"gain": 0.5}, {"load": 1.5}, seed=k) for k in range(20)]
    outcomes = [Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": p}) for p in peaks]
    whole = [replace(e, outcome=o) for e, o in zip(drawn, outcomes, strict=True)]
    trial = replace(make_trial(0, {"gain": 0.5}, [1.0]), evaluations=tuple(whole[:10]))
    trial = replace(trial, worst_case=None)
    check = [replace(e, stage=Stage.CHECK_DRAWN) for e in whole[10:]]
    extended, confirmed = with_check(study, trial, check)
    assert confirmed
    assert violated(study, extended) == ()

    remaining = iter(peaks)
    backend = function_backend(study, lambda **_: {"error": 1.0, "peak": next(remaining)})
    (validation,) = validate(study, backend, [{"gain": 0.5}])
    assert validation.feasible
    assert validation.constraints["peak"].violations == 2


def test_without_values_nothing_holds(make_study):
    assert not judge_sample(chance(make_study, 0.9), []).holds


def test_refuted_is_what_exceeds_by_more_than_the_error_of_the_estimate(make_study):
    """Samples with mean m and deviation s; s ** 2 (1 + z ** 2 / 2) / n is the error's square."""
    constraint = make_study().constraints["peak"]
    z, n = norm.ppf(constraint.probability), 10
    shape = np.linspace(-1.0, 1.0, n)
    shape /= shape.std(ddof=1)
    error = 0.1 * np.sqrt((1.0 + z**2 / 2.0) / n)
    edge = 1.0 - z * 0.1 + error
    assert not refuted(constraint, edge - 1e-6 + 0.1 * shape)
    assert refuted(constraint, edge + 1e-6 + 0.1 * shape)


@pytest.mark.parametrize("completed", [10, 19])
def test_a_check_that_broke_off_changes_no_worst_case(make_study, make_trial, completed):
    """What it saw of the worst context so far is no estimate of it."""
    study = make_study()
    trial = make_trial(3, {"gain": 0.5}, [1.0, 1.0], worst=0.9)
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.2})
    failed = Outcome(EvaluationState.FAILED, {}, "axis: stalled")
    stages = [Stage.CHECK_DRAWN] * 10 + [Stage.CHECK_WORST] * 10
    check = [
        replace(planned({"gain": 0.5}, {"load": 1.5}, stage=stage), index=2 + k, outcome=outcome)
        for k, stage in enumerate(stages)
    ]
    broken = [*check[:completed], replace(check[completed], outcome=failed)]
    extended, holds = with_check(study, trial, broken)
    assert not holds
    assert extended.worst_case == trial.worst_case
    whole, holds = with_check(study, trial, check)
    assert holds
    assert whole.worst_case.value == pytest.approx(0.2)
    assert len(check) == recommendation.CHECK_EVALUATIONS
