"""The scale on which a limited metric is modelled, and how it is chosen."""

from collections.abc import Callable
from typing import Protocol, Self

from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array


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


ScaleRule = Callable[[Array, float, float], ModelScale]
"""Chooses a scale by known values (n,) of a metric, its limit and the sign of that."""
