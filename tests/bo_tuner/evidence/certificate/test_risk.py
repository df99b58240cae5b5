"""Means and tails against scipy's tests and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from bo_tuner.evidence.certificate.risk import conditional_value_at_risk, mean_of
from bo_tuner.numerics.sequential import mean_bounds


class TestMean:
    @pytest.mark.parametrize("confidence", [0.5, 0.95])
    def test_scipy(self, confidence):
        values = np.random.default_rng(3).gamma(2.0, size=20)
        found = mean_of(values, confidence)
        test = stats.ttest_1samp(values, 0.0, alternative="less")
        assert found.value == pytest.approx(values.mean())
        assert found.standard_error == pytest.approx(stats.sem(values))
        # It holds after every value, so it is farther than one for twenty values.
        assert found.upper == mean_bounds(values, confidence)[-1]
        assert found.upper > test.confidence_interval(confidence).high

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
