"""The scale of a limited metric whose noise grows with its distance from an origin: logarithmic.

Durations, overshoots, errors and forces are never negative, and they vary by some percentage: their
noise is skewed, and the larger the farther from zero. On the scale

    z = L + w log((y - a) / w),    w = L - a,

of the metric y with the limit L and the origin a, such noise is normal and the same everywhere. The
map is increasing, keeps the limit, and has the slope 1 there. With a below all values it stretches
small ones and takes a long tail above; with a above them it does so with one below.

With normal noise of the deviation s on this scale, the metric is log-normal beside the origin, with
the mean a + w exp((μ - L) / w + s² / (2 w²)).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array

REACH = 0.5
"""Part of the least known ratio (y - a) / w below which a value counts as that part of it.

A value beyond the origin, which no value was before, has no logarithm. With it among the known ones
another scale is chosen.
"""


@dataclass(frozen=True)
class Logarithm:
    """Map of the values of a metric to a logarithmic scale; build it by `of`.

    Attributes
    ----------
    limit
        L, in the metric's unit.
    origin
        a, in the metric's unit; on one side of the limit and of all known values.
    least, most
        Least and largest known ratio (y - a) / w. No restored value is beyond the largest, as a
        small error of a logarithm would be a large one of the metric.
    """

    limit: float
    origin: float
    least: float = 1.0
    most: float = 1.0

    @classmethod
    def of(cls, y: Array, limit: float, origin: float) -> Self:
        """Make the map for known values (n,), which are on the limit's side of the origin.

        Raises
        ------
        ValueError
            If one is not, or the limit is at the origin.
        """
        width = limit - origin
        if not width:
            raise ValueError(f"a logarithmic scale needs a limit other than {origin:g}")
        ratio = (y - origin) / width
        if len(ratio) and ratio.min() <= 0.0:
            side = "above" if width > 0.0 else "below"
            found = float(y[ratio.argmin()])
            raise ValueError(f"a logarithmic scale needs values {side} {origin:g}, found {found:g}")
        ends = np.append(ratio, 1.0)
        return cls(limit, origin, float(ends.min()), float(ends.max()))

    @property
    def width(self) -> float:
        """Distance w of the limit from the origin, below 0 if the origin is above."""
        return self.limit - self.origin

    def including(self, value: float) -> Self:
        """Return the same map, with another known value."""
        ratio = self._ratio(value)
        return replace(
            self,
            least=min(self.least, float(ratio)),
            most=max(self.most, float(ratio)),
        )

    def apply(self, y: ArrayLike) -> Array:
        """Return values of the metric on the scale of the model, shape as `y`."""
        result: Array = self.limit + self.width * np.log(self._ratio(y))
        return result

    def restore(self, z: ArrayLike) -> Array:
        """Return values on the scale of the model in the metric's unit, shape as `z`."""
        exponent = (np.asarray(z, dtype=np.float64) - self.limit) / self.width
        return self._restored(exponent)

    def expectation(self, mean: Array, deviation: Array) -> Array:
        """Return the mean of the metric in its unit, with normal noise on this scale.

        Parameters
        ----------
        mean, deviation : ndarray of one shape
            Of the noise, on the scale of the model.
        """
        exponent = (mean - self.limit) / self.width + 0.5 * (deviation / self.width) ** 2
        return self._restored(exponent)

    def restore_deviation(self, deviation: ArrayLike, z: ArrayLike) -> Array:
        """Return a small deviation at z, on the scale of the model, in the metric's unit."""
        slope = (self.restore(z) - self.origin) / self.width
        result: Array = np.asarray(deviation) * slope
        return result

    def log_slopes(self, y: Array) -> Array:
        """Return the logarithm (n,) of dz/dy at known values (n,)."""
        result: Array = -np.log(self._ratio(y))
        return result

    def _ratio(self, y: ArrayLike) -> Array:
        ratio = (np.asarray(y, dtype=np.float64) - self.origin) / self.width
        return np.maximum(ratio, REACH * self.least)

    def _restored(self, exponent: Array) -> Array:
        result: Array = self.origin + self.width * np.exp(np.minimum(exponent, np.log(self.most)))
        return result
