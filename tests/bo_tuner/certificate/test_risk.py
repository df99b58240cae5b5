"""Bounds and tails against scipy's tests, binomial sums, and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from bo_tuner.certificate.risk import (
    conditional_value_at_risk,
    draws_needed,
    is_shown,
    mean_of,
    most_events,
    probability_bound,
)

SAMPLES = [(0, 1), (0, 25), (1, 25), (6, 300), (7, 300), (150, 300), (299, 300), (3, 10_000)]


class TestProbabilityBound:
    @pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.999])
    @pytest.mark.parametrize(("events", "draws"), SAMPLES)
    def test_scipy(self, events, draws, confidence):
        found = stats.binomtest(events, draws, alternative="less")
        expected = found.proportion_ci(confidence_level=confidence, method="exact").high
        assert probability_bound(events, draws, confidence) == pytest.approx(expected, rel=1e-9)

    @pytest.mark.parametrize(("events", "draws"), SAMPLES)
    def test_definition(self, events, draws):
        bound = probability_bound(events, draws, 0.95)
        assert stats.binom.cdf(events, draws, bound) == pytest.approx(0.05, rel=1e-9)

    def test_no_event(self):
        assert probability_bound(0, 300, 0.95) == pytest.approx(1.0 - 0.05 ** (1 / 300))

    def test_only_events(self):
        assert probability_bound(7, 7, 0.95) == 1.0

    @pytest.mark.parametrize("probability", [0.002, 0.01, 0.04, 0.3, 0.9])
    @pytest.mark.parametrize("draws", [20, 300])
    def test_it_covers_exactly(self, draws, probability):
        """Summed over all samples that there can be, it is too low in at most one of twenty."""
        too_low = [k for k in range(draws + 1) if probability_bound(k, draws, 0.95) < probability]
        assert stats.binom.pmf(too_low, draws, probability).sum() <= 0.05 + 1e-12

    @pytest.mark.parametrize(("events", "draws"), [(-1, 5), (6, 5), (0, 0)])
    def test_nonsense(self, events, draws):
        with pytest.raises(ValueError, match="expected 0 <= events <= draws"):
            probability_bound(events, draws, 0.95)


class TestDrawsNeeded:
    @pytest.mark.parametrize(
        ("allowed", "confidence", "expected"),
        # ln(1 - confidence) / ln(1 - allowed), the success-run theorem: 0.95 / 0.95 takes 59.
        [(0.05, 0.95, 59), (0.04, 0.95, 74), (0.1, 0.9, 22), (0.01, 0.95, 299), (0.5, 0.5, 1)],
    )
    def test_success_run(self, allowed, confidence, expected):
        assert draws_needed(allowed, confidence) == expected
        assert is_shown(0, expected, allowed, confidence)
        assert expected == 1 or not is_shown(0, expected - 1, allowed, confidence)

    @pytest.mark.parametrize("draws", [10, 73, 74, 118, 119, 300])
    def test_most_events(self, draws):
        """By the binomial tail: with k events it is shown if P(X <= k) at the limit is small."""
        tails = stats.binom.cdf(np.arange(draws), draws, 0.04)
        assert most_events(draws, 0.04, 0.95) == np.sum(tails <= 0.05) - 1


class TestMean:
    @pytest.mark.parametrize("confidence", [0.5, 0.95])
    def test_scipy(self, confidence):
        values = np.random.default_rng(3).gamma(2.0, size=20)
        found = mean_of(values, confidence)
        test = stats.ttest_1samp(values, 0.0, alternative="less")
        assert found.value == pytest.approx(values.mean())
        assert found.standard_error == pytest.approx(stats.sem(values))
        assert found.upper == pytest.approx(test.confidence_interval(confidence).high)

    def test_one_value_bounds_nothing(self):
        found = mean_of([2.0], 0.95)
        assert found.value == 2.0
        assert math.isnan(found.standard_error)
        assert found.upper == math.inf

    def test_none(self):
        assert math.isnan(mean_of([], 0.95).value)
        assert mean_of([], 0.95).upper == math.inf


class TestTail:
    @pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
    def test_normal(self, level):
        """By quantiles instead of draws: mu + sigma phi(z) / (1 - level)."""
        values = stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000, loc=3.0, scale=2.0)
        expected = 3.0 + 2.0 * stats.norm.pdf(stats.norm.ppf(level)) / (1.0 - level)
        assert conditional_value_at_risk(values, level) == pytest.approx(expected, rel=1e-3)

    @pytest.mark.parametrize("level", [0.1, 0.95])
    def test_uniform(self, level):
        values = (np.arange(20_000) + 0.5) / 20_000
        assert conditional_value_at_risk(values, level) == pytest.approx(0.5 * (1.0 + level))

    @pytest.mark.parametrize("count", [1, 7, 25, 300])
    def test_its_variational_form(self, count):
        """Rockafellar and Uryasev: the minimum over t of t + E[(x - t)+] / (1 - level)."""
        values = np.random.default_rng(count).standard_t(3.0, size=count)
        forms = [t + np.maximum(values - t, 0.0).mean() / 0.07 for t in values]
        assert conditional_value_at_risk(values, 0.93) == pytest.approx(min(forms))

    def test_a_part_of_a_value(self):
        assert conditional_value_at_risk(range(1, 11), 0.85) == pytest.approx((10 + 0.5 * 9) / 1.5)

    def test_none(self):
        assert math.isnan(conditional_value_at_risk([], 0.95))
