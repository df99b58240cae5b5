"""Which scale a limited metric is modelled on: the one on which its values are most likely.

Candidates are the metric itself, compressed far beyond its limit; its logarithm; and the logarithm
of its distance from an origin a little beyond its values, at either end. The likelihood is that of
a Gaussian process with equal noise everywhere, whose amplitude is the most likely one, the best of
a few length scales and shares of noise; times the slope of the scale at each value, so that all are
densities of the metric itself (Snelson and others 2004). One kernel serves all candidates, so this
takes less than a fit. The metric itself is kept unless another scale is much more likely.

References
----------
Snelson, Rasmussen and Ghahramani (2004). Warped Gaussian processes. NeurIPS 16.
"""

from collections.abc import Callable, Iterator
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bo_tuner.models.compression import Compression
from bo_tuner.models.hyperpriors import Hyperpriors
from bo_tuner.models.kernel import correlation
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.numerics.arrays import Array

FEWEST = 20
"""Observations from which on a scale is chosen by them."""

COMPARED = 200
"""Largest number of observations that a scale is chosen by."""

MUCH = 5.0
"""Log likelihood ratio from which on another scale than the metric's own is taken."""

STRETCHES = (0.4, 1.0, 2.5)
"""Length scales, relative to the median of their prior."""

NOISES = 10.0 ** np.arange(-4.0, 1.5, 0.5)
"""Variances of the noise, relative to that of the process."""

BEYOND = 0.2
"""Distance of an origin beyond the values, relative to that of their median from the last."""


class ModelScale(Protocol):
    """Increasing map of the values of a metric to the scale on which they are modelled.

    It keeps the limit.
    """

    def including(self, value: float) -> Self:
        """Return the same map, with another known value."""

    def apply(self, y: ArrayLike) -> Array:
        """Return values of the metric on the scale of the model, shape as `y`."""

    def restore(self, z: ArrayLike) -> Array:
        """Return values on the scale of the model in the metric's unit, shape as `z`."""

    def expectation(self, mean: Array, deviation: Array) -> Array:
        """Return the mean of the metric in its unit, with normal noise on this scale."""

    def restore_deviation(self, deviation: ArrayLike, z: ArrayLike) -> Array:
        """Return a small deviation at z, on the scale of the model, in the metric's unit."""

    def log_slopes(self, y: Array) -> Array:
        """Return the logarithm (n,) of the slope of the map at known values (n,)."""


ScaleRule = Callable[[Array, Array, float, float], ModelScale]
"""Chooses a scale by encoded joint points (n, d + e), values (n,), limit and sign of the limit."""


def most_likely(z: Array, y: Array, limit: float, sign: float) -> ModelScale:
    """Return the scale on which the values are most likely; see `ScaleRule`."""
    own = Compression.of(y, limit, sign)
    if len(y) < FEWEST or len(np.unique(y)) < FEWEST // 2:
        return own
    scales: list[ModelScale] = [own, *_logarithms(y, limit)]
    some = _spread_over(y)
    likelihoods = _log_likelihoods(z[some], y[some], scales)
    best = int(likelihoods.argmax())
    return own if likelihoods[best] < likelihoods[0] + MUCH else scales[best]


def logarithmic(z: Array, y: Array, limit: float, sign: float) -> ModelScale:
    """Return the logarithm, which a study asks for; see `ScaleRule`."""
    return Logarithm.of(y, limit, 0.0)


def as_it_is(z: Array, y: Array, limit: float, sign: float) -> ModelScale:
    """Return the metric's own scale, compressed far beyond its limit; see `ScaleRule`."""
    return Compression.of(y, limit, sign)


def _logarithms(y: Array, limit: float) -> Iterator[Logarithm]:
    """Yield the logarithmic candidates for values (n,)."""
    low, middle, high = np.quantile(np.append(y, limit), (0.0, 0.5, 1.0))
    if low > 0.0 or high < 0.0:
        yield Logarithm.of(y, limit, 0.0)
    yield Logarithm.of(y, limit, float(low - BEYOND * (middle - low)) - _least(y))
    yield Logarithm.of(y, limit, float(high + BEYOND * (high - middle)) + _least(y))


def _least(y: Array) -> float:
    """Return a distance that is small beside the values (n,), and not 0."""
    return 1e-3 * float(np.ptp(y))


def _spread_over(y: Array) -> NDArray[np.intp]:
    """Return `COMPARED` of the values y (n,) with the distribution of all, or all of them."""
    if len(y) <= COMPARED:
        return np.arange(len(y))
    ranks = np.linspace(0, len(y) - 1, COMPARED).round().astype(np.intp)
    return np.sort(np.argsort(y, kind="stable")[ranks])


def _log_likelihoods(z: Array, y: Array, scales: list[ModelScale]) -> Array:
    """Return the log density (s,) of the values y (n,) at z (n, d) by each of s scales."""
    count = len(y)
    there = np.column_stack([scale.apply(y) for scale in scales])
    there -= there.mean(axis=0)
    slopes = np.array([scale.log_slopes(y).sum() for scale in scales])
    median = np.exp(Hyperpriors.default(z.shape[1]).medians(z.shape[1])[:-2])
    best = np.full(len(scales), -np.inf)
    for stretch in STRETCHES:
        values, vectors = np.linalg.eigh(correlation(z, z, stretch * median))
        squares = (vectors.T @ there) ** 2
        for noise in NOISES:
            variances = np.maximum(values, 0.0) + noise
            amplitude = (squares / variances[:, None]).mean(axis=0)
            log = -0.5 * count * np.log(amplitude) - 0.5 * np.log(variances).sum()
            best = np.maximum(best, log + slopes)
    return best
