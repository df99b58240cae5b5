"""Bounds at every time at once: against quadrature, exact enumeration, and simulation."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from draws_needed import draws_needed_without_event, evidence_by_quadrature
from markdown_tables import columns_of
from scipy import integrate, optimize, stats

from bo_tuner.numerics.sequential import (
    draws_needed,
    is_hopeless,
    is_mean_refuted,
    is_refuted,
    is_shown,
    log_evidence,
    log_mean_evidence,
    mean_bounds,
    probability_bounds,
    spent,
)

PAGE = (Path(__file__).parents[3] / "docs" / "certificate.md").read_text()


def counts(n, k):
    """Draws of which the last k have the event."""
    return [False] * (n - k) + [True] * k


def where_shown(p, confidence, most):
    """For each number of draws and of events, (most + 1, most + 1): do they show it?"""
    shown = np.zeros((most + 1, most + 1), dtype=bool)
    for k in range(most):
        n = np.arange(max(k, 1), most + 1)
        # The evidence depends on the numbers only, not on the order.
        evidence = log_evidence(counts(k, k) + [False] * (most - k), p)
        shown[n, k] = evidence[n - 1] >= -math.log(1.0 - confidence)
    return shown


def ever_crossed(shown, p, most):
    """Exact probability to cross within `most` draws, each with an event by p; by recursion.

    Parameters: shown[n, k] tells whether k events in n draws cross.
    """
    alive, crossed = np.array([1.0]), 0.0
    for n in range(1, most + 1):
        alive = np.append(alive, 0.0) * (1.0 - p) + np.append(0.0, alive) * p
        now = shown[n, : n + 1]
        crossed += alive[now].sum()
        alive[now] = 0.0
    return crossed


def draws_times_probability(error):
    """The a = n p at which the mean over u in (0, 1) of exp(a (1 - u²)) reaches 1 / error."""

    def excess(a):
        return integrate.quad(lambda u: math.exp(a * (1.0 - u**2)), 0.0, 1.0)[0] - 1.0 / error

    return optimize.brentq(excess, 0.1, 50.0)


class TestProbability:
    @pytest.mark.parametrize("p", [0.01, 0.04, 0.15, 0.5, 0.9])
    @pytest.mark.parametrize(("n", "k"), [(1, 0), (1, 1), (40, 0), (40, 3), (300, 6), (300, 30)])
    def test_quadrature(self, n, k, p):
        expected = evidence_by_quadrature(k, n, p)
        found = log_evidence(counts(n, k), p)[-1]
        assert found == pytest.approx(math.log(expected), rel=1e-6, abs=1e-6)

    @pytest.mark.parametrize("p", [0.04, 0.15, 0.5])
    def test_it_is_a_martingale_at_the_limit_and_falls_above(self, p):
        """E[E_n] over all samples that there can be."""
        n = 60
        evidence = np.exp([log_evidence(counts(n, k), p)[-1] for k in range(n + 1)])
        for truth in (p, 1.1 * p, 0.5 * (1.0 + p)):
            mean = stats.binom.pmf(np.arange(n + 1), n, truth) @ evidence
            assert mean == pytest.approx(1.0) if truth == p else mean < 1.0

    @pytest.mark.parametrize("p", [0.04, 0.15, 0.5])
    def test_looking_after_every_draw_errs_in_one_of_twenty_at_most(self, p):
        """Exact. A bound for a fixed number of draws errs far more often if looked at so."""
        most = 400
        fixed = np.zeros((most + 1, most + 1), dtype=bool)
        for k in range(most):
            n = np.arange(max(k, 1), most + 1)
            fixed[n, k] = stats.binom.cdf(k, n, p) <= 0.05
        assert 0.01 < ever_crossed(where_shown(p, 0.95, most), p, most) <= 0.05
        assert ever_crossed(fixed, p, most) > 0.12

    @pytest.mark.parametrize("most", [300, 1000])
    def test_what_the_document_says_of_who_keeps_a_limit_by_little(self, most):
        told = re.search(
            r"probability\sof 0\.02 where 0\.04 is allowed, (\d+) % pass the first certificate "
            r"within 1000 test runs, (\d+) % within 300; with 0\.01, (all) and\s(\d+) %",
            PAGE,
        )
        of_1000, of_300, all_of_1000, rest_of_300 = told.groups()
        assert all_of_1000 == "all"
        page = {1000: (int(of_1000), 100), 300: (int(of_300), int(rest_of_300))}[most]
        shown = where_shown(0.04, spent(0.95, 1), most)
        found = [ever_crossed(shown, truth, most) for truth in (0.02, 0.01)]
        assert tuple(round(100 * power) for power in found) == page

    @pytest.mark.parametrize(
        ("row", "p"), [(0, 0.04), (1, 0.15)], ids=["chance", "runs in a context"]
    )
    def test_what_the_document_says_that_further_certificates_cost(self, row, p):
        table = re.search(r"^\| certificate \|.*(?:\n\|.*)+", PAGE, re.MULTILINE).group()
        told = columns_of(table, row)
        assert told.pop("certificate").endswith(f"for p = {1.0 - p:.2f}")
        needed = {
            f"{attempt}{suffix}": str(draws_needed_without_event(p, error))
            for attempt, suffix, error in (
                (1, "st", 0.04),
                (2, "nd", 0.01 / 2),
                (5, "th", 0.01 / 20),
                (20, "th", 0.01 / 380),
            )
        }
        assert told == needed

    def test_the_bound_is_where_the_evidence_suffices(self):
        rng = np.random.default_rng(2)
        events = rng.random(200) < 0.03
        bounds = probability_bounds(events, 0.95)
        assert np.all(np.diff(bounds) <= 0.0)
        for n in (1, 20, 93, 200):
            assert is_shown(events[:n], bounds[n - 1] + 1e-9, 0.95)
            assert not is_shown(events[:n], bounds[n - 1] - 1e-9, 0.95)
        # Close to the one for a fixed number; the lowest so far may even be below it.
        exact = stats.binomtest(int(events.sum()), 200, alternative="less")
        high = exact.proportion_ci(0.95, "exact").high
        assert 0.9 * high < bounds[-1] < 1.5 * high

    def test_only_events(self):
        assert probability_bounds([True] * 7, 0.95).tolist() == pytest.approx([1.0] * 7)

    def test_later_draws_that_contradict_earlier_ones_count(self):
        """22 good ones show 0.12, and 8 bad ones then make the share 0.27: draws are not alike."""
        good, all_of_them = [False] * 22, [False] * 22 + [True] * 8
        assert is_shown(good, 0.12, 0.875)
        assert not is_shown(all_of_them, 0.12, 0.875)
        assert probability_bounds(all_of_them, 0.875)[-1] == pytest.approx(8 / 30)

    def test_refuted_is_the_same_of_the_other_event(self):
        assert is_refuted([True] * 5, 0.04, 0.95)
        assert not is_refuted([True, *[False] * 20], 0.04, 0.95)
        assert is_refuted([True] * 93, 0.96, 0.95)
        assert not is_refuted([True] * 92, 0.96, 0.95)

    @pytest.mark.parametrize(("allowed", "confidence"), [(0.04, 0.95), (0.15, 0.975), (0.5, 0.5)])
    def test_draws_needed(self, allowed, confidence):
        needed = draws_needed(allowed, confidence)
        assert is_shown([False] * needed, allowed, confidence)
        assert not is_shown([False] * (needed - 1), allowed, confidence)
        assert needed >= math.log(1.0 - confidence) / math.log(1.0 - allowed)

    @pytest.mark.parametrize("allowed", [1e-5, 1e-8, 1.2e-16])
    def test_draws_needed_for_almost_certainty(self, allowed):
        """For small p and no event, E_n is a function of n p alone: needed is as 1 / p."""
        needed = draws_needed(allowed, 0.975)
        assert needed * allowed == pytest.approx(draws_times_probability(0.025), rel=1e-3)

    def test_hopeless_is_what_no_further_luck_can_show(self):
        events = [True] * 4
        least = next(n for n in range(5, 999) if not is_hopeless(events, n, 0.04, 0.95))
        assert is_shown(events + [False] * (least - 4), 0.04, 0.95)
        assert is_hopeless(events, least - 1, 0.04, 0.95)


class TestMean:
    @pytest.mark.parametrize("values", [[0.3], [-0.2, -0.9, 0.1], [-1.0, -1.2, -0.7, -1.1, -0.9]])
    def test_quadrature(self, values):
        """The ratio of the two marginal likelihoods, with u = log σ."""
        x = np.array(values)

        def likelihood(delta, u):
            return math.exp(-0.5 * np.sum((x / math.exp(u) - delta) ** 2) - u * len(x))

        def alternative(delta, u):
            return 2.0 * stats.norm.pdf(delta) * likelihood(delta, u)

        above, _ = integrate.dblquad(alternative, -6.0, 6.0, -9.0, 0.0)
        below, _ = integrate.quad(lambda u: likelihood(0.0, u), -6.0, 6.0)
        found = log_mean_evidence(x, 0.0)[-1]
        # A single value tells nothing of a scale that is not known, save its sign.
        assert found == pytest.approx(math.log(above / below), abs=0.02)

    def test_shift_and_scale_change_nothing(self):
        x = np.random.default_rng(5).normal(0.5, 1.0, 30)
        expected = log_mean_evidence(x, 0.9)
        assert log_mean_evidence(1e4 + 1e-3 * x, 1e4 + 0.9e-3) == pytest.approx(expected, rel=1e-6)

    @pytest.mark.parametrize("deviation", [0.01, 100.0])
    def test_looking_after_every_value_errs_in_one_of_twenty_at_most(self, deviation):
        rng = np.random.default_rng(11)
        runs, most = 300, 200
        samples = 3.0 + deviation * rng.standard_normal((runs, most))
        # At any time, also if later values take the mean back.
        shown = np.mean([log_mean_evidence(s, 3.0).max() >= math.log(20.0) for s in samples])
        refuted = np.mean([is_mean_refuted(sample, 3.0, 0.95) for sample in samples])
        error = 3.0 * math.sqrt(0.05 * 0.95 / runs)
        assert 0.0 < shown <= 0.05 + error
        assert 0.0 < refuted <= 0.05 + error
        below = [mean_bounds(sample, 0.95)[-1] < 3.0 for sample in samples[:30]]
        evidence = [log_mean_evidence(sample, 3.0).max() for sample in samples[:30]]
        held = [sample.mean() < 3.0 for sample in samples[:30]]
        assert below == [e >= math.log(20.0) and h for e, h in zip(evidence, held, strict=True)]

    def test_values_without_noise(self):
        assert is_mean_refuted([1.5] * 8, 1.0, 0.95)
        assert not is_mean_refuted([1.0] * 50, 1.0, 0.95)

    def test_later_values_that_contradict_earlier_ones_count(self):
        steady = [0.9 + 0.01 * (-1) ** k for k in range(30)]
        assert mean_bounds(steady, 0.95)[-1] < 1.0
        assert mean_bounds([*steady, *[1.5] * 10], 0.95)[-1] == pytest.approx(1.05)

    def test_few_values_bound_nothing(self):
        assert mean_bounds([], 0.95).shape == (0,)
        assert mean_bounds([1.0, 1.1], 0.95).tolist() == [math.inf, math.inf]


def test_all_attempts_together_spend_what_one_may():
    shares = [1.0 - spent(0.95, attempt) for attempt in range(1, 2001)]
    assert shares[0] == pytest.approx(0.04)
    assert shares[1:] == sorted(shares[1:], reverse=True)
    assert sum(shares) == pytest.approx(0.05 - 0.01 / 2000)
    assert 2.0 * (1.0 - spent(0.95, 3, subjects=2)) == pytest.approx(shares[2])
