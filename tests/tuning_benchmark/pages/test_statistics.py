"""Intervals against their textbook forms, written out by hand."""

import numpy as np
import pytest
from scipy import special, stats

from tuning_benchmark.pages.statistics import difference, fisher, mcnemar, mean, power, share


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


def test_an_interval_widens_with_its_confidence():
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    found = mean(values, 0.99)
    # 0.995 quantile of Student's t with 4 degrees of freedom, from a printed table.
    assert found.high - 3.0 == pytest.approx(4.604 * np.sqrt(0.5), abs=1e-3)


def test_a_difference_is_that_of_pairs():
    """The spread that runs of one seed have in common is no part of it."""
    seeds = range(1, 6)
    common = dict(zip(seeds, [10.0, 50.0, 20.0, 90.0, 40.0], strict=True))
    gaps = dict(zip(seeds, [1.0, 2.0, 1.5, 0.5, 1.0], strict=True))
    first = {seed: common[seed] + gaps[seed] for seed in seeds}
    found = difference(first, common, 0.9)
    other = stats.ttest_rel(list(first.values()), list(common.values())).confidence_interval(0.9)
    assert (found.value, found.count) == (pytest.approx(1.2), 5)
    assert (found.low, found.high) == pytest.approx((other.low, other.high))


def test_seeds_without_a_partner_are_left_out():
    found = difference({1: 3.0, 2: 100.0, 4: 6.0}, {4: 4.0, 1: 2.0, 3: -100.0})
    assert (found.value, found.count) == (1.5, 2)
    assert np.isnan(difference({1: 1.0, 2: 2.0}, {1: 0.0}).low)
    assert difference({1: 1.0}, {2: 2.0}).count == 0


@pytest.mark.parametrize(
    ("first", "second", "p"),
    [
        # Of 20 runs with 10 successes: two tails of 1 in (20 over 10).
        ((10, 10), (0, 10), 2.0 / special.comb(20, 10)),
        # Fisher's lady tasting tea: (1 + 16) of 70, on either side.
        ((3, 4), (1, 4), 34.0 / 70.0),
        ((5, 10), (5, 10), 1.0),
        ((10, 10), (10, 10), 1.0),
    ],
)
def test_counts_are_told_apart_as_by_counting_tables(first, second, p):
    assert fisher(first, second) == pytest.approx(p)


def test_power_law():
    x = [50.0, 100.0, 200.0, 400.0]
    found = power(x, [0.5 * value**1.7 for value in x])
    assert (found.exponent, found.factor) == pytest.approx((1.7, 0.5))
    noisy = [3.0, 4.0, 11.0, 30.0]
    assert power(x, noisy).exponent == pytest.approx(stats.linregress(np.log(x), np.log(noisy))[0])


def test_mcnemar_is_a_fair_coin_over_the_pairs_that_differ():
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(3, 3) == 1.0
    assert mcnemar(6, 0) == pytest.approx(2 * 0.5**6)
    assert mcnemar(1, 5) == pytest.approx(2 * (1 + 6) * 0.5**6)
