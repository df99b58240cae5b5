"""How many evaluations a certificate probably takes: against exact counts and what it took."""

import math

import numpy as np
import pytest
from certified import collect
from functions import make_trial

from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.outlook import Outlook, outlook, runs_to_show, runs_to_show_mean
from bo_tuner.numerics.sequential import draws_needed, is_shown, log_mean_evidence
from bo_tuner.trials import Trial, TrialState, WorstCase

MEAN = {"peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0}}


@pytest.mark.parametrize("allowed", [0.01, 0.04, 0.15])
def test_without_a_violation_they_are_the_fewest(allowed):
    assert runs_to_show(0.0, allowed, 1000, 0.95) == draws_needed(allowed, 0.95)


def test_one_violation_in_twenty_runs():
    """About as with one at the beginning of each twenty."""
    n = runs_to_show(0.05, 0.15, 1000, 0.95)
    assert not is_shown([k % 20 == 0 for k in range(n - 10)], 0.15, 0.95)
    assert is_shown([k % 20 == 0 for k in range(n + 20)], 0.15, 0.95)
    assert runs_to_show(0.16, 0.15, 1000, 0.95) == 1000


@pytest.mark.parametrize("margin", [0.2, 0.5])
def test_a_mean_by_its_margin(margin):
    """Runs with exactly this mean and standard deviation, in pairs."""
    n = runs_to_show_mean(margin, 1000, 0.95)
    for count, shown in ((n - 4, False), (n + 4, True)):
        values = np.tile([1.0, -1.0], count // 2) - margin
        assert bool(log_mean_evidence(values, 0.0)[-1] >= math.log(20.0)) is shown


def certified(study, function_backend, margin, noise=0.1):
    """What the certificate of a flat metric with this margin in deviations took."""

    def function(seed, **_):
        rng = np.random.default_rng(seed)
        return {"error": 1.0, "peak": 1.0 - noise * margin + noise * rng.standard_normal()}

    (found,) = collect(study, function_backend(study, function), 1000, tuned=0.5)
    return judge(study, found, 0.95)


@pytest.mark.parametrize("margin", [0.6, 3.0])
def test_a_certificate_takes_about_as_many(make_study, function_backend, margin):
    study, noise = make_study(constraints=MEAN), 0.1
    value = 1.0 - margin * noise
    trial = Trial(
        0,
        {"gain": 0.5},
        "",
        TrialState.COMPLETE,
        worst_cases={"peak": WorstCase(value, {"load": 1.5}, value, noise)},
    )
    probable = outlook(study, trial, (), 1000, 0.95)
    verdict = certified(study, function_backend, margin)
    assert verdict.passed
    assert 0.5 * probable.low <= verdict.evaluations <= 2.0 * probable.high
    assert probable.high <= 6 * probable.low


def test_of_bets_in_a_range_nothing_is_told(make_study):
    """They take other runs than the tests of normal and log-normal noise."""
    metrics = {"error": {"node": "axis"}, "peak": {"node": "axis", "range": [0.0, 10.0]}}
    study = make_study(constraints=MEAN, metrics=metrics)
    worst = {"peak": WorstCase(0.9, {"load": 1.5}, 0.9, 0.1)}
    trial = Trial(0, {"gain": 0.5}, "", TrialState.COMPLETE, worst_cases=worst)
    assert outlook(make_study(constraints=MEAN), trial, (), 1000, 0.95) is not None
    assert outlook(study, trial, (), 1000, 0.95) is None


def test_what_is_not_known_is_not_told(make_study):
    """No noise of the worst case; no draws for a chance constraint."""
    assert outlook(make_study(), make_trial(0, {"gain": 0.5}, [1.0]), (), 1000, 0.95) is None
    limit = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}
    study = make_study(constraints={"peak": limit})
    assert outlook(study, make_trial(0, {"gain": 0.5}, [1.0]), (), 1000, 0.95) is None
    assert str(Outlook(30, 30)) == "30"
    assert str(Outlook(30, 99)) == "30 to 99"
