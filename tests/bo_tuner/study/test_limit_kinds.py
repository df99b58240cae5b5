"""What every kind of limit must keep to, whoever has made it."""

from math import isfinite

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.evidence.limit_proof import Runs, proof_of_kind
from bo_tuner.evidence.reasons import Why
from bo_tuner.evidence.words.limit_kinds import words_of_kind
from bo_tuner.numerics.two_kinds import runs_to_see
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.on_mean import OnMean
from bo_tuner.study.limit_kinds.registry import KINDS

CONFIDENCE = 0.95
LEAST = runs_to_see(0.5 * (1.0 + CONFIDENCE))


class MeanOverContexts(OnMean):
    """From outside: the mean over contexts and noise keeps the limit."""

    in_every_context = False

    def check(self):
        pass

    def response(self, models):
        return models.over_contexts(self.limited, 0.5)


@pytest.fixture(params=["chance", "worst_case", "worst_case on runs", "mean"])
def rule(request, monkeypatch):
    """A limit of 1 of each kind, an upper one."""
    monkeypatch.setitem(KINDS, "mean", MeanOverContexts)
    kind, _, on_runs = request.param.partition(" on ")
    share = {"probability": 0.9} if on_runs or kind == "chance" else {}
    return Constraint(name="c", kind=kind, metric="m", upper=1.0, **share).rule


def runs_of(rule, values):
    values = np.array(values)
    events = rule.limited.violations(values).tolist()
    return Runs(events, values, rule.limited.farthest(values))


def spread_around(mean, count=200):
    """Values with this mean and the standard deviation 0.1."""
    quantiles = norm.ppf((np.random.default_rng(3).permutation(count) + 0.5) / count)
    return mean + 0.1 * quantiles / quantiles.std()


def test_runs_far_within_the_limit_show_it(rule):
    runs = runs_of(rule, spread_around(0.5))
    assert proof_of_kind(rule).is_shown(runs, CONFIDENCE)
    assert not proof_of_kind(rule).is_refuted(runs, CONFIDENCE)
    assert not proof_of_kind(rule).is_hopeless(runs, 1000, CONFIDENCE)
    assert rule.agrees(runs.values, alone=False)
    assert not proof_of_kind(rule).contradicts(proof_of_kind(rule).together(runs))


def test_runs_far_beyond_the_limit_refute_it(rule):
    runs = runs_of(rule, spread_around(1.5))
    assert proof_of_kind(rule).is_refuted(runs, CONFIDENCE)
    assert not proof_of_kind(rule).is_shown(runs, CONFIDENCE)
    assert not rule.agrees(runs.values, alone=False)
    assert proof_of_kind(rule).contradicts(proof_of_kind(rule).together(runs))


def test_a_few_runs_show_nothing_and_refute_nothing(rule):
    runs = runs_of(rule, [0.5, 0.6])
    assert not proof_of_kind(rule).is_shown(runs, CONFIDENCE)
    assert not proof_of_kind(rule).is_refuted(runs, CONFIDENCE)
    assert not proof_of_kind(rule).is_hopeless(runs, 1000, CONFIDENCE)


def test_a_lower_limit_is_the_mirror_image(rule):
    mirrored = type(rule)(
        Constraint(
            name="c", kind="worst_case", metric="m", lower=-1.0,
            probability=rule.limited.probability,
        )
    )  # fmt: skip
    for mean in (0.5, 0.9, 1.0, 1.5):
        values = spread_around(mean, 40)
        there, here = runs_of(mirrored, -values), runs_of(rule, values)
        assert proof_of_kind(mirrored).is_shown(there, CONFIDENCE) == proof_of_kind(rule).is_shown(
            here, CONFIDENCE
        )
        assert proof_of_kind(mirrored).is_refuted(there, CONFIDENCE) == proof_of_kind(
            rule
        ).is_refuted(here, CONFIDENCE)
        assert mirrored.agrees(-values, alone=True) == rule.agrees(values, alone=True)


def test_only_what_draws_estimate_is_judged_by_the_estimate(rule):
    """Six of ten values are a little beyond the limit, and so is their mean: by chance, maybe."""
    values = np.array([0.9] * 4 + [1.08] * 6)
    assert not rule.agrees(values, alone=True)
    alone = rule.agrees(values, alone=False)
    assert alone == (rule.in_every_context and not rule.on_runs)


def test_its_words_name_the_limit_and_what_was_found(rule):
    beyond = runs_of(rule, spread_around(1.5, 90))
    found = proof_of_kind(rule).by_draws(beyond, CONFIDENCE)
    assert found.why is (Why.SHARE if rule.on_runs else Why.MEAN)
    assert rule.on_runs or found.bound > 1.0
    assert words_of_kind(rule).asked(everywhere=False)
    assert (
        words_of_kind(rule).asked(everywhere=True).endswith(" in every context")
        or not rule.in_every_context
    )
    assert "m" in words_of_kind(rule).predicted("m", quantile=False).split()


def test_a_mean_over_draws_takes_enough_of_them(monkeypatch):
    monkeypatch.setitem(KINDS, "mean", MeanOverContexts)
    rule = Constraint(name="c", kind="mean", metric="m", upper=1.0).rule
    for count in (LEAST - 2, LEAST):
        runs = runs_of(rule, spread_around(0.5, count))
        assert proof_of_kind(rule).is_shown(runs, CONFIDENCE) == (count >= LEAST)
        bound = proof_of_kind(rule).by_draws(runs, CONFIDENCE).bound
        assert 0.5 < bound < 0.6 if count >= LEAST else not isfinite(bound)
