"""The fit of a shifted log-normal law, and its likelihood ratio: against scipy's optimum."""

import math

import numpy as np
import pytest
from scipy import optimize, stats

from bo_tuner.numerics.skewed_means import LogNormalFit, fit


def log_normal(count, sigma, seed=1):
    return np.exp(sigma * np.random.default_rng(seed).standard_normal(count))


def test_the_root_is_that_of_the_likelihood_ratio():
    """With the shift known, the likelihood is maximized numerically at a mean of m."""
    logs = np.log(log_normal(40, 0.8))
    found = LogNormalFit(40, 0.0, float(logs.mean()), float(logs.var()))
    for mean in (0.9, 1.3, 2.5):

        def cost(u, mean=mean):
            v = math.exp(u)
            return -stats.norm.logpdf(logs, math.log(mean) - 0.5 * v, math.sqrt(v)).sum()

        within = optimize.minimize_scalar(cost, bounds=(-5.0, 4.0), method="bounded").fun
        best = -stats.norm.logpdf(logs, logs.mean(), logs.std()).sum()
        assert abs(found.root(mean)) == pytest.approx(math.sqrt(2.0 * (within - best)), rel=1e-4)
    expected = math.exp(logs.mean() + 0.5 * logs.var())
    assert found.root(1.01 * expected) < 0.0 < found.root(0.99 * expected)
    assert found.root(expected) == pytest.approx(0.0, abs=1e-6)


def test_far_from_the_values_it_is_the_t_statistic():
    """A log-normal law with a far shift is a normal one."""
    x, shift = np.random.default_rng(3).normal(2.0, 0.5, 25), -1e5
    logs = np.log(x - shift)
    found = LogNormalFit(25, shift, float(logs.mean()), float(logs.var()))
    for mean in (1.8, 2.3):
        expected = stats.ttest_1samp(x, mean).statistic
        assert found.statistic(mean) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("shift", [-3.0, 0.0, 40.0])
def test_the_shift_is_found_in_many_values(shift):
    x = shift + log_normal(20_000, 0.8)
    assert fit(x).shift == pytest.approx(shift, abs=0.1)


def test_it_is_more_skewed_than_the_sample():
    """By one standard error to the left in the logarithm."""
    x = log_normal(30, 0.5)
    found = fit(x)
    error = math.sqrt(6.0 * 28.0 / (31.0 * 33.0))
    assert stats.skew(np.log(x - found.shift)) == pytest.approx(-error, abs=1e-3)


def test_of_two_values_the_law_is_not_far_more_skewed():
    """Of two values that are as frequent, the logarithm has no skewness whatever the shift is."""
    for count in (30, 300):
        variance = fit(np.tile([0.4, 0.6], count // 2)).variance
        error = math.sqrt(6.0 * (count - 2.0) / ((count + 1.0) * (count + 3.0)))
        assert stats.lognorm.stats(math.sqrt(variance), moments="s") <= 6.0 * error


def test_what_is_skewed_to_the_left_has_no_fit():
    assert fit(-log_normal(50, 1.0)) is None
    assert fit(np.full(10, 2.0)) is None
    # Equal but for rounding.
    assert fit(0.1 * np.array([3.0, 3.0, 3.0, 3.0 + 1e-15])) is None
    assert fit(np.random.default_rng(0).normal(size=40)) is not None


def test_units_change_nothing():
    x = log_normal(30, 0.8)
    one, other = fit(x), fit(7.0 + 1e-3 * x)
    assert one.statistic(2.0) == pytest.approx(other.statistic(7.002), rel=1e-5)


def test_a_mean_below_the_shift_is_impossible():
    found = fit(log_normal(30, 0.8))
    assert found.statistic(found.shift - 1.0) == math.inf
