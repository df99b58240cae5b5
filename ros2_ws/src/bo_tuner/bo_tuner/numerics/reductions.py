"""Single numbers out of the arrays of one message, such as the nearest of the ranges of a scan.

A reduction takes all of its arguments as one array (n,), in their order: ``min(ranges, 10)`` is the
nearest range, or 10 where none is nearer. What is NaN or infinite counts as it is; `finite` leaves
it out.
"""

from collections.abc import Callable, Mapping
from math import atan2
from types import MappingProxyType

import numpy as np

from bo_tuner.numerics.arrays import Array


class EmptyArrayError(ValueError):
    """A number such as the smallest one is not defined for an array without items."""


def finite(values: Array) -> Array:
    """Return what is neither NaN nor infinite (m,) of values (n,)."""
    return values[np.isfinite(values)]


def minimum(values: Array) -> float:
    """Smallest of values (n,), n ≥ 1; NaN if one is."""
    return float(_some(values).min())


def maximum(values: Array) -> float:
    """Largest of values (n,), n ≥ 1; NaN if one is."""
    return float(_some(values).max())


def mean(values: Array) -> float:
    """Mean of values (n,), n ≥ 1."""
    return float(_some(values).mean())


def total(values: Array) -> float:
    """Sum of values (n,); 0 of none."""
    return float(values.sum())


def norm(values: Array) -> float:
    """Root of the sum of the squares of values (n,); 0 of none."""
    return float(np.linalg.norm(values))


def roll(quaternion: Array) -> float:
    """Angle about the x axis [rad], -π to π, of a quaternion (4,) as x, y, z, w (REP 103)."""
    x, y, z, w = _unit(quaternion)
    return atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))


def pitch(quaternion: Array) -> float:
    """Angle about the y axis [rad], -π/2 to π/2, of a quaternion (4,) as x, y, z, w (REP 103)."""
    x, y, z, w = _unit(quaternion)
    # Rounding must not lead out of the domain.
    return float(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))


def yaw(quaternion: Array) -> float:
    """Angle about the z axis [rad], -π to π, of a rotation about the fixed axes x, y, z (REP 103).

    The quaternion (4,) is (x, y, z, w), of any length; if that is 0, the angle is NaN.
    """
    x, y, z, w = _unit(quaternion)
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


REDUCTIONS: Mapping[str, Callable[[Array], float]] = MappingProxyType(
    {"min": minimum, "max": maximum, "mean": mean, "sum": total, "norm": norm}
)
"""Functions of an array (n,), by their names in a field of a study."""
FILTERS: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {"abs": np.abs, "finite": finite}
)
"""Functions from an array to another one, for the argument of a reduction."""
ANGLES: Mapping[str, Callable[[Array], float]] = MappingProxyType(
    {"roll": roll, "pitch": pitch, "yaw": yaw}
)
"""Functions of a quaternion (4,)."""


def _some(values: Array) -> Array:
    if not len(values):
        raise EmptyArrayError
    return values


def _unit(quaternion: Array) -> Array:
    length = np.linalg.norm(quaternion)
    return quaternion / length if length > 0.0 else np.full(4, np.nan)
