"""Samples of a posterior over the unit cube, by sequential Monte Carlo with a tempered likelihood.

The target goes from the uniform prior to the posterior in steps of the power of the likelihood,
each so large that half of the weighted samples count; after each step the samples are drawn anew by
their weights and moved by random walks that keep the target (Del Moral, Doucet and Jasra 2006). So
a likelihood that leaves a thousandth of the cube, or several islands of it, is met by all samples.

References
----------
Del Moral, Doucet and Jasra (2006). Sequential Monte Carlo samplers. Journal of the Royal
Statistical Society B 68(3).
"""

from collections.abc import Callable

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube

COUNT = 2000
"""Number of samples."""
EFFECTIVE = 0.5
"""Effective share of the samples after a step."""
MOVES = 8
"""Moves of each sample after a step."""
HALVINGS = 40
"""Steps of the bisection of the power; the interval shrinks to the rounding of its ends."""
LOW_ACCEPTANCE, HIGH_ACCEPTANCE = 0.2, 0.4
"""Share of moves that are accepted, outside of which their size is changed by a third."""


def sample_posterior(
    log_likelihood: Callable[[Array], Array],
    dimension: int,
    rng: np.random.Generator,
    count: int = COUNT,
) -> Array:
    """Return m = `count` equally weighted samples (m, d) of the posterior.

    Parameters
    ----------
    log_likelihood
        Returns the log likelihoods (m,) at points (m, d) of the unit cube, all finite.
    dimension
        Number of columns d of the cube, at least 1.
    rng
        Draws the samples.
    count
        Number of samples.
    """
    points = latin_hypercube(count, dimension, rng)
    values = log_likelihood(points)
    power, size = 0.0, 2.38 / np.sqrt(dimension)
    while power < 1.0:
        step = _step(values, 1.0 - power)
        weights = np.exp(step * (values - values.max()))
        chosen = _resample(weights / weights.sum(), rng)
        points, values = points[chosen], values[chosen]
        power = min(power + step, 1.0)
        # Where samples agree in a column, as for a variable of two values, it still moves.
        spread = np.cov(points.T).reshape(dimension, dimension) + 1e-6 * np.eye(dimension)
        factor = np.linalg.cholesky(spread)
        for _ in range(MOVES):
            shift = size * rng.standard_normal(points.shape) @ factor.T
            moved = _reflected(points + shift)
            there = log_likelihood(moved)
            accepted = np.log(rng.random(count)) < power * (there - values)
            points = np.where(accepted[:, None], moved, points)
            values = np.where(accepted, there, values)
            rate = accepted.mean()
            size *= 0.67 if rate < LOW_ACCEPTANCE else 1.5 if rate > HIGH_ACCEPTANCE else 1.0
            size = min(size, 2.38)
    return points


def _step(values: Array, largest: float) -> float:
    """Return the largest power, up to `largest`, at which enough of the samples (m,) count."""

    def effective(power: float) -> float:
        weights = np.exp(power * (values - values.max()))
        return float(weights.sum() ** 2 / (weights**2).sum()) / len(values)

    if effective(largest) >= EFFECTIVE:
        return largest
    low, high = 0.0, largest
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= EFFECTIVE else (low, middle)
    return high


def _resample(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """Return positions (m,) drawn by their weights (m,), systematically: each about its share."""
    positions = (rng.random() + np.arange(len(weights))) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), len(weights) - 1)


def _reflected(points: Array) -> Array:
    """Return points mirrored at the sides of the cube, which keeps a random walk symmetric."""
    turned = np.mod(points, 2.0)
    return np.where(turned > 1.0, 2.0 - turned, turned)
