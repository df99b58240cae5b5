"""Whether a limit holds: one rule for all that use it."""

from dataclasses import replace

import numpy as np
import pytest
from functions import planned
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, norm, ttest_1samp

from bo_tuner.methods.repetitions import most_check_evaluations
from bo_tuner.monitoring.progress import describe
from bo_tuner.study.limits import (
    judge_sample,
    judge_samples,
    outcome_in_words,
    refuted,
    tightest,
    violated,
    worst_case_holds,
)
from bo_tuner.text import JOIN
from bo_tuner.trials import EvaluationState, Outcome, Stage, WorstCase
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.validation import ValidationPlan
from tuning_benchmark.paper.check import with_check

CHANCE = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}


def chance(make_study, probability):
    study = make_study(constraints={"peak": CHANCE | {"probability": probability}})
    return study.constraints["peak"]


def worst_case(make_study, probability=None):
    limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
    given = {} if probability is None else {"probability": probability}
    return make_study(constraints={"peak": limit | given}).constraints["peak"]


@pytest.mark.parametrize(
    ("worst", "probability", "found"),
    [
        (0.5, 0.9, "within limits"),
        # Ten of a hundred runs are beyond a mean plus 1.28 deviations of 0.1.
        (0.86, 0.9, "within limits"),
        (0.88, 0.9, "may violate peak"),
        (0.88, None, "within limits"),
        (1.01, 0.9, "violates peak"),
        (1.01, None, "violates peak"),
    ],
)
def test_a_worst_case_within_its_limit_is_not_called_a_violation(
    make_study, make_trial, worst, probability, found
):
    limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
    given = {} if probability is None else {"probability": probability}
    study = make_study(constraints={"peak": limit | given})
    trial = make_trial(0, {"gain": 0.5}, [1.0], worst=worst, noise=0.1)
    assert outcome_in_words(study, trial) == found
    # Of a limit on single runs the value is the quantile: 1.28 deviations of 0.1 above the mean.
    value = worst if probability is None else round(worst + 0.1282, 3)
    kind = "margin too small" if found.startswith("may") else "over the limit"
    on_screen = f"{kind} (peak {value:g} > 1)"
    assert describe(trial, study).endswith(f"  {on_screen}  [1{JOIN}test{JOIN}run]") is (
        found != "within limits"
    )


@pytest.mark.parametrize(("probability", "name"), [(None, "error"), (0.9, "peak")])
def test_the_tightest_limit_on_single_runs_is_by_what_must_keep_it(
    make_study, make_trial, probability, name
):
    """A mean of 0.8 with deviations of 0.1: the 0.9 quantile, 0.928, is nearer to 1 than 0.9."""
    given = {} if probability is None else {"probability": probability}
    worst = {"kind": "worst_case", "upper": 1.0}
    study = make_study(
        constraints={
            "error": worst | {"metric": "error"},
            "peak": worst | {"metric": "peak"} | given,
        }
    )
    trial = make_trial(0, {"gain": 0.5}, [1.0])
    found = {
        "error": WorstCase(0.9, {"load": 1.0}, 0.9, 0.0),
        "peak": WorstCase(0.8, {"load": 2.0}, 0.8, 0.1),
    }
    trial = replace(trial, worst_cases=found)
    constraint, case = tightest(study, trial)
    assert (constraint.name, case) == (name, found[name])


@pytest.mark.parametrize(("count", "probability"), [(10, 0.85), (25, 0.85), (25, 0.5), (300, 0.99)])
def test_draws_refute_a_worst_case_by_more_violations_than_chance_explains(
    make_study, count, probability
):
    most = worst_case(make_study, probability).rule.most_violations(count, alone=False)
    violations = binom(count, 1.0 - probability)
    assert violations.sf(most - 1) >= 0.05 > violations.sf(most)


def test_draws_refute_a_limit_on_the_mean_by_their_mean(make_study):
    """As a one-sided test of Student's, of level 5 %."""
    constraint = worst_case(make_study)
    shape = np.linspace(-1.0, 1.0, 20)
    for mean in np.linspace(0.8, 1.5, 15):
        values = mean + shape
        refuted_by = ttest_1samp(values, 1.0, alternative="greater").pvalue < 0.05
        assert judge_sample(constraint, values).agrees is not refuted_by
    assert judge_sample(constraint, [5.0]).agrees


@pytest.mark.parametrize("limit", [0.05, 0.1, 0.2, 0.4])
@pytest.mark.parametrize("count", [2, 10, 25])
def test_values_at_the_limit_keep_it(make_study, limit, count):
    """The mean of 25 times 0.2 is above 0.2 by rounding."""
    constraint = replace(worst_case(make_study), upper=limit)
    assert judge_sample(constraint, [limit] * count).agrees
    assert not refuted(constraint, [limit] * count)


@pytest.mark.parametrize("probability", [None, 0.85])
def test_without_contexts_draws_are_of_the_worst_one(make_study, probability):
    """They estimate what holds there; three of 20 may violate a limit that 15 % of runs may."""
    constraint = worst_case(make_study, probability)
    within = [1.2] * 3 + [0.9] * 17
    beyond = [1.2] * (12 if probability is None else 4) + [0.9] * (8 if probability is None else 16)
    assert judge_sample(constraint, beyond).agrees or probability is None
    assert judge_sample(constraint, within, alone=True).agrees
    assert not judge_sample(constraint, beyond, alone=True).agrees


@pytest.mark.parametrize(("probability", "holds"), [(None, True), (0.5, True), (0.85, False)])
def test_a_worst_case_is_judged_by_what_its_limit_is_on(make_study, probability, holds):
    """Mean 0.98, deviation 0.03: one run in four exceeds 1."""
    estimate = WorstCase(0.98, {"load": 2.0}, 1.01, 0.03)
    assert worst_case_holds(worst_case(make_study, probability), estimate) is holds


@given(percent=st.integers(50, 99), hundreds=st.integers(1, 50))
def test_a_share_that_is_allowed_exactly_holds(make_study, percent, hundreds):
    """Of 100 draws, exactly 100 - percent may violate the limit, despite rounding."""
    constraint = chance(make_study, percent / 100.0)
    assert constraint.rule.permitted(100 * hundreds) == (100 - percent) * hundreds


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
    trial = replace(trial, worst_cases={})
    check = [replace(e, stage=Stage.CHECK_DRAWN) for e in whole[10:]]
    extended, confirmed = with_check(study, trial, check)
    assert confirmed
    assert violated(study, extended) == ()

    remaining = iter(peaks)
    backend = function_backend(study, lambda **_: {"error": 1.0, "peak": next(remaining)})
    plan = ValidationPlan(study, [{"gain": 0.5}])
    Driver(backend).complete(plan)
    (validation,) = plan.results
    assert validation.feasible
    assert validation.constraints["peak"].violations == 2


def test_without_values_nothing_holds(make_study):
    assert not judge_sample(chance(make_study, 0.9), []).agrees


def test_refuted_is_what_exceeds_by_more_than_the_error_of_the_estimate(make_study):
    """Samples with mean m and deviation s; s ** 2 (1 + z ** 2 / 2) / n is the error's square."""
    constraint = worst_case(make_study, 0.85)
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
    assert extended.worst_cases == trial.worst_cases
    whole, holds = with_check(study, trial, check)
    assert holds
    assert whole.worst_cases["peak"].value == pytest.approx(0.2)
    assert len(check) == most_check_evaluations(study)


def test_a_check_without_contexts_judges_its_draws_as_all_others(make_study, make_trial):
    """Draws of the only context estimate the limit: with probability 0.9, one of ten may break it.

    As draws of many contexts they would have to refute it, which takes four.
    """
    constraint = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.9}
    study = make_study(contexts={}, constraints={"peak": constraint})
    trial = replace(make_trial(0, {"gain": 0.5}, [1.0]), worst_cases={})
    trial = replace(trial, worst_cases={"peak": WorstCase(0.5, {}, 0.5)})
    stages = [Stage.CHECK_DRAWN] * 10 + [Stage.CHECK_WORST] * 10
    for beyond in (1, 2):
        peaks = [1.001] * beyond + [0.5] * (20 - beyond)
        check = [
            replace(
                planned({"gain": 0.5}, {}, stage=stage, seed=k),
                outcome=Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": peak}),
            )
            for k, (stage, peak) in enumerate(zip(stages, peaks, strict=True))
        ]
        _, holds = with_check(study, trial, check)
        assert holds is judge_samples(study, check[:10])["peak"].agrees is (beyond == 1)
