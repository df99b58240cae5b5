"""Samples of posteriors over the unit cube, against closed forms."""

import numpy as np
import pytest

from bo_tuner.numerics.tempering import sample_posterior


def rng():
    return np.random.default_rng(3)


@pytest.mark.parametrize("deviation", [0.05, 0.001])
def test_a_normal_likelihood_far_from_the_sides(deviation):
    """Also one that leaves a millionth of the square."""
    centre = np.array([0.4, 0.7])
    samples = sample_posterior(
        lambda u: -0.5 * (((u - centre) / deviation) ** 2).sum(axis=1), 2, rng()
    )
    assert samples.mean(axis=0) == pytest.approx(centre, abs=0.15 * deviation)
    assert samples.std(axis=0) == pytest.approx([deviation, deviation], rel=0.1)


def test_correlated_columns():
    """Of a likelihood of the sum alone, the columns are what they are given their sum."""
    samples = sample_posterior(lambda u: -0.5 * ((u.sum(axis=1) - 1.0) / 0.01) ** 2, 2, rng())
    assert samples.sum(axis=1).std() == pytest.approx(0.01, rel=0.1)
    # Uniform along the diagonal from (0, 1) to (1, 0).
    assert samples[:, 0].std() == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.1)


def test_without_a_likelihood_it_is_uniform():
    samples = sample_posterior(lambda u: np.zeros(len(u)), 1, rng())[:, 0]
    assert np.quantile(samples, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.03)


def test_two_islands_are_both_met():
    def log_likelihood(u):
        near, far = (-0.5 * ((u[:, 0] - c) / 0.01) ** 2 for c in (0.2, 0.9))
        return np.logaddexp(near, far)

    samples = sample_posterior(log_likelihood, 1, rng())[:, 0]
    assert np.mean(samples < 0.5) == pytest.approx(0.5, abs=0.1)


def test_at_a_side_nothing_is_lost():
    """An exponential density that is largest at 0; its mean is its decay."""
    samples = sample_posterior(lambda u: -u[:, 0] / 0.02, 1, rng())[:, 0]
    assert samples.min() >= 0.0
    assert samples.mean() == pytest.approx(0.02, rel=0.1)
