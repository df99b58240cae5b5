"""Bets on a mean: against a product by hand, exact expectations, and simulation."""

import math

import numpy as np
import pytest

from bo_tuner.numerics.bounded_means import BETS, SHARES, log_wealth


def wealth_by_hand(values, mean, high):
    """Mean wealth of all bets, each a product over the values."""
    shares = SHARES / SHARES.sum()
    return sum(
        share * math.prod(1.0 + bet / (high - mean) * (mean - x) for x in values)
        for bet, share in zip(BETS, shares, strict=True)
    )


def test_it_is_the_product_of_what_the_bets_gain():
    values = [0.2, 0.9, 0.1, 0.4, 0.0]
    expected = [math.log(wealth_by_hand(values[:n], 0.6, 2.0)) for n in range(1, 6)]
    assert log_wealth(values, 0.6, 2.0) == pytest.approx(expected)


@pytest.mark.parametrize("probability", [0.01, 0.3, 0.9])
def test_at_the_limit_its_expectation_is_one(probability):
    """Of two values 0 and 1, exact over all sequences of ten; at a larger mean it is less."""
    for truth, expected in ((probability, 1.0), (0.5 * (1.0 + probability), None)):
        total = 0.0
        for index in range(2**10):
            x = np.array([(index >> k) & 1 for k in range(10)], dtype=float)
            weight = truth ** x.sum() * (1.0 - truth) ** (10 - x.sum())
            total += weight * math.exp(log_wealth(x, probability, 1.0)[-1])
        assert total == pytest.approx(1.0) if expected else total < 1.0


def test_it_increases_with_the_mean():
    x = np.random.default_rng(2).uniform(size=50)
    evidence = [log_wealth(x, m, 1.0)[-1] for m in np.linspace(0.05, 0.99, 40)]
    assert evidence == sorted(evidence)


def test_the_end_of_the_range():
    assert log_wealth([1.0, 1.0], 1.0, 1.0).tolist() == [0.0, 0.0]
    assert log_wealth([1.0, 0.9], 1.0, 1.0).tolist() == [0.0, math.inf]
    assert log_wealth([0.5], 1.1, 1.0).tolist() == [math.inf]
    # One that has lost all keeps nothing, and the smaller bets go on.
    assert np.isfinite(log_wealth([1.0, 0.0], 0.5, 1.0)).all()
