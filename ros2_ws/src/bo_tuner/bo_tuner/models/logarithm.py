"""The scale of a limited metric whose noise grows in proportion to it: logarithmic.

On the scale z = L + L log(y / L) of the metric y with the limit L, noise in proportion to the
metric is the same everywhere. The map is increasing, keeps the limit, and has the slope 1 there.
With normal noise of the deviation s on this scale the metric is log-normal, with the mean
L exp((μ - L) / L + s² / (2 L²)). A search for the worst case of a lower limit mirrors metric and
limit: both are negative then, and the same holds.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array


@dataclass(frozen=True)
class Logarithm:
    """Map of the values of a metric to the logarithmic scale; build it by `of`.

    Attributes
    ----------
    limit
        L, in the metric's unit; not 0.
    most
        Largest known ratio y / L. No restored value is beyond it: a small error of a logarithm
        would be a large one of the metric.
    """

    limit: float
    most: float = 1.0

    @classmethod
    def of(cls, y: Array, limit: float, sign: float = 1.0) -> Self:
        """Make the map for known values (n,), see `ScaleRule`.

        Raises
        ------
        ValueError
            If the limit is 0, or a value has not its sign.
        """
        if not limit:
            raise ValueError("a logarithmic scale needs a limit other than 0")
        scale = cls(limit)
        for value in y:
            scale = scale.including(float(value))
        return scale

    def including(self, value: float) -> Self:
        """Return the same map, with another known value."""
        ratio = value / self.limit
        if ratio <= 0.0:
            side = "above" if self.limit > 0.0 else "below"
            raise ValueError(f"a logarithmic scale needs values {side} 0, found {value:g}")
        return replace(self, most=max(self.most, ratio))

    def apply(self, y: ArrayLike) -> Array:
        """Return values of the metric on the scale of the model, shape as `y`."""
        ratio = np.asarray(y, dtype=np.float64) / self.limit
        result: Array = self.limit * (1.0 + np.log(ratio))
        return result

    def restore(self, z: ArrayLike) -> Array:
        """Return values on the scale of the model in the metric's unit, shape as `z`."""
        return self._restored(np.asarray(z, dtype=np.float64) / self.limit - 1.0)

    def expectation(self, mean: Array, deviation: Array) -> Array:
        """Return the mean of the metric in its unit, with normal noise on this scale.

        Parameters
        ----------
        mean, deviation : ndarray of one shape
            Of the noise, on the scale of the model.
        """
        return self._restored(mean / self.limit - 1.0 + 0.5 * (deviation / self.limit) ** 2)

    def restore_deviation(self, deviation: ArrayLike, z: ArrayLike) -> Array:
        """Return a small deviation at z, on the scale of the model, in the metric's unit."""
        result: Array = np.asarray(deviation) * self.restore(z) / self.limit
        return result

    def _restored(self, exponent: Array) -> Array:
        result: Array = self.limit * np.exp(np.minimum(exponent, np.log(self.most)))
        return result
