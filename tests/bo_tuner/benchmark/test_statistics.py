"""Intervals against their textbook forms, written out by hand."""

import numpy as np
import pytest
from scipy import special

from bo_tuner.benchmark.statistics import difference, exponent, mean, share


def test_mean_of_one_to_five():
    found = mean([1.0, 2.0, 3.0, 4.0, 5.0])
    # 0.975 quantile of Student's t with 4 degrees of freedom, from a printed table.
    half = 2.776 * np.sqrt(2.5 / 5.0)
    assert (found.value, found.count) == (3.0, 5)
    assert (found.low, found.high) == pytest.approx((3.0 - half, 3.0 + half), abs=1e-3)


def test_mean_of_few():
    assert np.isnan(mean([]).value)
    single = mean([2.0])
    assert single.value == 2.0
    assert np.isnan([single.low, single.high]).all()


@pytest.mark.parametrize(("count", "runs"), [(0, 10), (3, 10), (10, 10), (1, 2)])
def test_share_is_between_quantiles_of_the_beta_distribution(count, runs):
    low = special.betaincinv(count, runs - count + 1, 0.025) if count else 0.0
    high = special.betaincinv(count + 1, runs - count, 0.975) if count < runs else 1.0
    found = share(count, runs)
    assert found.value == count / runs
    assert (found.low, found.high) == pytest.approx((low, high))


def test_difference_of_two_means_by_welch():
    a, b = np.array([3.0, 5.0, 7.0]), np.array([1.0, 2.0, 2.0, 3.0])
    found = difference(a, b)
    u, v = a.var(ddof=1) / 3, b.var(ddof=1) / 4
    degrees = (u + v) ** 2 / (u**2 / 2 + v**2 / 3)
    half = special.stdtrit(degrees, 0.975) * np.sqrt(u + v)
    assert found.value == pytest.approx(3.0)
    assert (found.low, found.high) == pytest.approx((3.0 - half, 3.0 + half))
    assert np.isnan(difference([1.0], [2.0, 3.0]).low)


def test_exponent_of_a_power_law():
    x = np.array([50.0, 100.0, 200.0, 400.0])
    found = exponent(x, 0.5 * x**1.7)
    assert (found.value, found.factor) == pytest.approx((1.7, 0.5))
    assert found.low == pytest.approx(found.high, abs=1e-6)
    noisy = exponent(x, 0.5 * x**1.7 * np.array([1.1, 0.9, 1.1, 0.9]))
    assert noisy.low < 1.7 < noisy.high
