"""The scale of a limited metric: as it is up to some distance beyond its limit, then logarithmic.

Where a loop is close to instability, a metric can be a hundred times its limit. A process that has
to explain such values, too, is too coarse to say which side of the limit the others are on, and all
that matters of them is that they are far beyond it. So only a distance d > W beyond the limit is
changed, to W (1 + log(d / W)), where the width W is the largest distance of a value within the
limit, or the median distance of all values if that is larger. (Eriksson and Poloczek, 2021, take
the logarithm on both sides of the limit, which would change what runs near it show.)

The map is increasing, so it maps quantiles to quantiles. It does not map means to means: a mean is
larger than what the mean on this scale stands for, which matters where most runs are within the
limit and a few far beyond it. With normal noise on this scale it is that of a normal distribution
up to W and of a log-normal one beyond.

References
----------
Eriksson and Poloczek (2021). Scalable constrained Bayesian optimization. AISTATS.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from bo_tuner.numerics.arrays import Array

REACH = 6.0
"""Standard deviations within which noise counts."""


@dataclass(frozen=True)
class Compression:
    """Map of the values of a metric to the scale on which they are modelled; build it by `of`.

    Attributes
    ----------
    limit
        In the metric's unit.
    sign
        1 for an upper limit, -1 for a lower one.
    width
        W in the metric's unit; infinite if nothing is changed.
    largest
        Largest distance beyond the limit of a known value. No restored one is farther: a small
        error of a logarithm would be a large one of the metric.
    """

    limit: float = 0.0
    sign: float = 1.0
    width: float = np.inf
    largest: float = 0.0

    @classmethod
    def of(cls, y: Array, limit: float, sign: float = 1.0) -> Self:
        """Choose the width by the known values (n,) of a metric."""
        beyond = sign * (y - limit)
        if not len(y):
            return cls(limit, sign)
        width, largest = max(-beyond.min(), np.median(abs(beyond))), beyond.max()
        if not 0.0 < width < largest:
            return cls(limit, sign)
        return cls(limit, sign, float(width), float(largest))

    def including(self, value: float) -> Self:
        """Return the same map, with another known value."""
        return replace(self, largest=max(self.largest, self.sign * (value - self.limit)))

    def apply(self, y: ArrayLike) -> Array:
        """Return values of the metric on the scale of the model, shape as `y`."""
        values = np.asarray(y, dtype=np.float64)
        ratio = self.sign * (values - self.limit) / self.width
        far = self.width * (1.0 + np.log(np.maximum(ratio, 1.0)))
        return np.where(ratio > 1.0, self.limit + self.sign * far, values)

    def restore(self, z: ArrayLike) -> Array:
        """Return values on the scale of the model in the metric's unit, shape as `z`."""
        values = np.asarray(z, dtype=np.float64)
        far = np.minimum(self.width * self._stretch(values), self.largest)
        return np.where(self._is_far(values), self.limit + self.sign * far, values)

    def expectation(self, mean: Array, deviation: Array) -> Array:
        """Return the mean (m,) of the metric in its unit, with normal noise on this scale.

        With X the distance beyond the limit, mean μ and standard deviation s, it is that of X up to
        W and of W exp(X / W - 1) beyond.

        Parameters
        ----------
        mean, deviation : ndarray, shape (m,)
            Of the noise, on the scale of the model.
        """
        if not np.isfinite(self.width):
            return mean
        s = np.maximum(deviation / self.width, np.finfo(np.float64).tiny)
        mu = self.sign * (mean - self.limit) / self.width
        left = (1.0 - mu) / s
        most = max(self.largest / self.width, 1.0)
        with np.errstate(over="ignore", invalid="ignore"):
            near = mu * ndtr(left) - s * np.exp(-0.5 * left**2) / np.sqrt(2.0 * np.pi)
            far = np.exp(mu - 1.0 + 0.5 * s**2) * ndtr(s - left)
        expected = np.clip(near + far, mu, most)
        # Elsewhere the noise does not reach so far.
        return np.where(left < REACH, self.limit + self.sign * self.width * expected, mean)

    def restore_deviation(self, deviation: ArrayLike, z: ArrayLike) -> Array:
        """Return a small deviation at z, on the scale of the model, in the metric's unit."""
        values = np.asarray(z, dtype=np.float64)
        stretched: Array = np.asarray(deviation) * np.where(
            self._is_far(values), self._stretch(values), 1.0
        )
        return stretched

    def _is_far(self, z: Array) -> NDArray[np.bool_]:
        return np.asarray(self.sign * (z - self.limit) > self.width)

    def _stretch(self, z: Array) -> Array:
        """Return exp(d / W - 1) of the distance d beyond the limit, at most that of `largest`."""
        ratio = self.sign * (z - self.limit) / self.width
        most = max(self.largest / self.width, 1.0)
        factor: Array = np.exp(np.minimum(ratio - 1.0, np.log(most)))
        return factor


NO_COMPRESSION = Compression()
"""The scale of the metric itself."""
