"""How many evaluations a certificate probably takes: against counts of its own and what it took."""

import numpy as np
import pytest
from certified import CHANCE, collect

from bo_tuner.evidence.certificate.certification import most_evaluations
from bo_tuner.evidence.certificate.independent_search import (
    least_candidates,
    least_searched,
    most_candidates,
    most_searched,
)
from bo_tuner.evidence.certificate.judgement import judge, least_evaluations
from bo_tuner.evidence.certificate.outlook import Outlook, outlook
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.numerics.sequential import log_evidence
from bo_tuner.numerics.two_kinds import runs_to_see
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, WorstCase

MEAN = {"peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0}}


def certified(study, function_backend, margin, noise=0.1):
    """What the certificate of a flat metric with this margin in deviations took."""

    def function(seed, **_):
        rng = np.random.default_rng(seed)
        return {"error": 1.0, "peak": 1.0 - noise * margin + noise * rng.standard_normal()}

    (found,) = collect(study, function_backend(study, function), 1000, tuned=0.5)
    return judge(study, found, 0.95)


def estimated(margin, noise=0.1):
    """A worst case with this margin in deviations."""
    value = 1.0 - margin * noise
    return {"peak": WorstCase(value, {"load": 1.5}, value, noise)}


def draws(count, above):
    """Draws of which some are beyond a limit of 1."""
    outcomes = [
        Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 1.1 if k < above else 0.5})
        for k in range(count)
    ]
    return [
        Evaluation(1, k, Stage.VALIDATION, {"gain": 0.5}, {"load": 1.5}, k, outcome)
        for k, outcome in enumerate(outcomes)
    ]


@pytest.mark.parametrize("margin", [0.6, 3.0])
def test_a_certificate_takes_about_as_many(make_study, function_backend, margin):
    study = make_study(constraints=MEAN)
    probable = outlook(study, 1000, 0.95, draws(25, 0), estimated(margin))
    verdict = certified(study, function_backend, margin)
    assert verdict.passed
    assert 0.5 * probable.low <= verdict.evaluations <= 2.0 * probable.high
    assert probable.high <= 6 * probable.low


def test_a_range_holds_eight_in_ten_draws(make_study):
    """Of true shares from the posterior of 1 in 50 draws, by Bernoulli draws of its own."""
    study, known = make_study(**CHANCE), draws(50, 1)
    probable = outlook(study, 1000, 0.95, known)
    rng, taken = np.random.default_rng(5), []
    for _ in range(300):
        events = rng.random(1000) < rng.beta(1.5, 49.5)
        # Of a test martingale with a level of 1 in 20 (Ville's inequality).
        reached = np.flatnonzero(log_evidence(events, 0.04) >= np.log(20.0))[:1]
        taken += [max(30, n + 1) for n in reached]
    assert sum(n > probable.high for n in taken) / len(taken) == pytest.approx(0.1, abs=0.07)
    # More than one in ten take the fewest.
    assert sum(n < probable.low for n in taken) / len(taken) <= 0.17


def test_a_limit_that_is_kept_by_far_takes_about_the_fewest(make_study):
    study = make_study(constraints=MEAN)
    probable = outlook(study, 1000, 0.95, draws(25, 0), estimated(10.0))
    space = study.context_space()
    # Each candidate takes the runs that show a rare kind, and no more.
    each = runs_to_see(0.975)
    least = 30 + least_searched(space, 1) + least_candidates(space) * each
    most = 30 + most_searched(space, 1) + most_candidates(space) * each
    assert least <= probable.low <= probable.high <= most


def test_one_that_is_broken_has_no_certificate(make_study):
    study = make_study(constraints=MEAN)
    assert outlook(study, 1000, 0.95, draws(25, 0), estimated(-3.0)) is None


def test_bets_take_more_in_a_wider_range(make_study):
    found = []
    for high in (2.0, 50.0):
        metrics = {"error": {"node": "axis"}, "peak": {"node": "axis", "range": [0.0, high]}}
        study = make_study(constraints=MEAN, metrics=metrics)
        found.append(outlook(study, 1000, 0.95, draws(25, 0), estimated(3.0)))
    assert found[0].high < found[1].low


@pytest.mark.parametrize("limit", [MEAN, CHANCE["constraints"], {}])
def test_of_an_unknown_result_it_is_between_the_least_and_the_most(make_study, limit):
    study = make_study(constraints=limit)
    probable = outlook(study, 1000, 0.95)
    most = most_evaluations(study, [Subject("tuned", {"gain": 0.5}, ({},))], 1000).total
    assert max(30, least_evaluations(study, 0.95)) <= probable.low <= probable.high <= most


def test_in_words():
    assert str(Outlook(30, 30)) == "30"
    assert str(Outlook(30, 99)) == "30 to 99"
