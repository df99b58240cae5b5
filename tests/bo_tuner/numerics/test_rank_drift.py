"""The group-sequential rank test, against SciPy, counting and its own error probability."""

import numpy as np
import pytest
from scipy.stats import beta, mannwhitneyu

from bo_tuner.numerics.rank_drift import RankTest


def test_the_statistic_is_that_of_mann_and_whitney():
    rng = np.random.default_rng(2)
    # Rounded, so that there are ties.
    old, new = rng.normal(size=15).round(1), rng.normal(size=6).round(1)
    test = RankTest(15, 8, 0.05)
    for t in range(1, 7):
        u = mannwhitneyu(new[:t], old).statistic
        z = (u - 15 * t / 2) / np.sqrt(15 * t * (16 + t) / 12)
        assert test.statistics(old, new[:t])[-1] == pytest.approx(z * np.sqrt(t / 8))


def test_few_values_by_counting():
    """One fresh value beyond two others is found in two of three orders."""
    assert RankTest(2, 1, 0.7).found_after([1.0, 2.0], [3.0]) == 1
    assert RankTest(2, 1, 0.7).found_after([1.0, 2.0], [0.0]) == 1
    assert RankTest(2, 1, 0.7).found_after([1.0, 2.0], [1.5]) is None
    assert RankTest(2, 1, 0.6).found_after([1.0, 2.0], [3.0]) is None


def test_an_error_probability_below_that_of_any_order_finds_nothing():
    assert RankTest(20, 5, 1e-9).bound == np.inf
    assert RankTest(20, 5, 1e-9).found_after(np.zeros(20), np.full(5, 9.0)) is None
    assert RankTest(20, 5, 1e-9).effect(0.95) == np.inf


@pytest.mark.parametrize("law", ["exponential", "integers"])
def test_false_alarms_are_as_few_as_stated_whatever_the_distribution(law):
    rng, test = np.random.default_rng(5), RankTest(25, 12, 0.1)

    def draw(shape):
        return rng.exponential(size=shape) if law == "exponential" else rng.integers(0, 4, shape)

    old, new = draw((4000, 25)), draw((4000, 12))
    share = (np.abs(test.statistics(old, new)) >= test.bound).any(axis=1).mean()
    # Three standard deviations of 4000 trials.
    assert share <= 0.1 + 3 * np.sqrt(0.1 * 0.9 / 4000)
    # Ties make it fewer.
    assert law == "integers" or share >= 0.07


def test_the_effect_that_is_stated_is_found_as_often():
    test, rng = RankTest(60, 20, 0.05), np.random.default_rng(11)
    old, new = rng.normal(size=(2000, 60)), rng.normal(size=(2000, 20)) + test.effect(0.9)
    share = (np.abs(test.statistics(old, new)) >= test.bound).any(axis=1).mean()
    assert share == pytest.approx(0.9, abs=0.03)
    # A fixed sample of normal values with known deviation cannot do better.
    z = 1.959964 + 1.281552
    assert test.effect(0.9) > z * np.sqrt(1 / 20 + 1 / 60)


def test_a_large_shift_is_found_before_the_end():
    old = np.arange(60.0)
    after = RankTest(60, 20, 0.05).found_after(old, np.full(20, 100.0))
    assert after is not None
    assert after < 12
    assert RankTest(60, 20, 0.05).found_after(old, np.full(20, np.inf)) == after


@pytest.mark.parametrize("share", [0.5, 0.95])
def test_the_rate_of_one_baseline(share):
    """With one fresh run: the length of the intervals beyond extreme values of uniform ones.

    Of n uniform values any j of the n + 1 intervals have the length Beta(j, n + 1 - j).
    """
    test = RankTest(59, 1, 0.1)
    ranks = np.arange(60.0)
    extreme = int((np.abs(test.scaled(ranks[:, None])) >= test.bound).sum())
    assert 0 < extreme <= 6
    rate = beta.ppf(share, extreme, 60 - extreme)
    assert test.rate(share) == pytest.approx(rate, rel=0.15)
