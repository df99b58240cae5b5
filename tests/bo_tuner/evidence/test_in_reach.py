"""What is said to be in reach where no trial keeps all limits, and what to change."""

from dataclasses import replace

import pytest

from bo_tuner.evidence.in_reach import in_reach
from bo_tuner.trials import WorstCase


def trials_of(make_trial, *runs):
    """Trials of a gain each, with the values of the peak in drawn contexts and in the worst one."""
    trials = []
    for number, (gain, peaks, worst) in enumerate(runs):
        trial = make_trial(number, {"gain": gain}, [1.0] * len(peaks))
        evaluations = tuple(
            replace(e, outcome=replace(e.outcome, metrics={"error": 1.0, "peak": peak}))
            for e, peak in zip(trial.evaluations, peaks, strict=True)
        )
        found = WorstCase(worst, {"load": 2.0}, worst)
        worst_cases = dict.fromkeys(("peak", "far"), found)
        trials.append(replace(trial, evaluations=evaluations, worst_cases=worst_cases))
    return trials


@pytest.fixture
def told(make_study, make_trial):
    """Function that returns the advice on trials, in a study with other sections."""

    def told(*runs, **sections):
        return in_reach(make_study(**sections), trials_of(make_trial, *runs))

    return told


def test_the_smallest_value_is_named_and_the_limit(told):
    first, second = told((0.3, [1.8, 1.9], 2.0), (0.4, [1.2, 1.3], 1.5), (0.5, [3.0, 3.0], 4.0))
    assert first == (
        "In reach: the smallest peak of any trial in the worst context is 1.5 (trial 1), the limit "
        "is 1."
    )
    # In the drawn contexts the limit is not kept either.
    assert second == "Loosen the limit to at least 1.5, with some margin, or tune other parameters."


def test_of_a_lower_limit_it_is_the_largest(told):
    limit = {"peak": {"kind": "worst_case", "metric": "peak", "lower": 5.0}}
    first, second = told((0.3, [1.8], 2.0), (0.4, [3.0], 2.5), constraints=limit)
    assert "the largest peak of any trial in the worst context is 2.5 (trial 1)" in first
    assert second.startswith("Loosen the limit to at most 2.5,")


def test_at_a_bound_the_range_comes_first(told):
    _, second = told((0.0, [1.2], 1.5), (0.4, [1.8], 2.0))
    assert second == "That trial is at the lower bound of gain: widen the range first."


def test_where_only_extreme_contexts_break_it_these_are_named(told):
    _, second = told((0.4, [0.7, 0.9], 1.5))
    assert second.startswith("In the contexts that were drawn at random it is 0.8 on average")
    assert "narrow them if the machine cannot differ so much" in second


def test_a_limit_that_is_kept_with_too_little_to_spare_is_the_hardest_one(told):
    limits = {
        name: {"kind": "worst_case", "metric": metric, "upper": upper}
        for name, metric, upper in (("peak", "peak", 1.0), ("far", "error", 100.0))
    }
    first, second = told((0.4, [0.9], 0.99), constraints=limits)
    assert "peak" in first
    assert "0.99 (trial 0), the limit is 1." in first
    assert "run more trials, or loosen this limit" in second


def test_a_share_of_runs_is_judged_by_the_run_that_as_many_must_keep(told):
    """Of ten runs nine must keep the limit, so it is the ninth that decides."""
    limit = {"often": {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}}
    first, _ = told((0.4, [float(k) for k in range(11, 21)], 0.0), constraints=limit)
    assert "smallest peak that runs of a trial keep as often as they must is 19 (trial 0)" in first


def test_without_a_complete_trial_there_is_none(make_study):
    assert in_reach(make_study(), ()) == ()


def test_a_limit_that_the_validation_has_refuted_is_named_although_trials_kept_it(
    make_study, make_trial
):
    limits = {
        name: {"kind": "worst_case", "metric": metric, "upper": upper}
        for name, metric, upper in (("peak", "peak", 1.0), ("far", "error", 100.0))
    }
    study = make_study(constraints=limits)
    first, *_ = in_reach(study, trials_of(make_trial, (0.4, [0.9], 0.99)), violated=["far"])
    assert "the smallest error of any trial in the worst context" in first
