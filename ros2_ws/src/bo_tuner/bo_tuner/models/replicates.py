"""Sufficient statistics of repeated observations and the standardization of responses.

Notation: N observations y of n distinct points x in the unit cube of dimension d; point i has
r_i observations with the mean ȳ_i.

References
----------
Binois, Gramacy and Ludkovski (2018). Practical heteroscedastic Gaussian process modeling for
large simulation experiments. Journal of Computational and Graphical Statistics 27(4), Section 2.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bo_tuner import maxima
from bo_tuner.numerics.arrays import Array

# Squares of responses must neither overflow nor vanish: beyond these magnitudes a number is a
# mistake (often a crash that was turned into a huge cost), not a measurement.
SMALLEST_SCALE = 1e-100
# A spread below this fraction of the largest magnitude is rounding, not variation.
CONSTANT_FRACTION = 1e-12
CUBE_TOLERANCE = 1e-9


def checked_data(x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Return points x (N, d) in the unit cube and responses y (N,), N and d ≥ 1, as floats.

    Raises
    ------
    ValueError
        If a shape does not fit or an entry is not finite or out of range.
    """
    points = np.asarray(x, dtype=np.float64)
    responses = np.asarray(y, dtype=np.float64)
    if points.ndim != 2 or 0 in points.shape:
        raise ValueError(f"x: expected shape (N, d) with N, d >= 1, found {points.shape}")
    if responses.shape != points.shape[:1]:
        raise ValueError(f"y: expected shape ({len(points)},) to match x, found {responses.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"x: expected finite values, found {_first_not_finite(points)}")
    if not np.isfinite(responses).all():
        raise ValueError(f"y: expected finite values, found {_first_not_finite(responses)}")
    distance = np.maximum(points - 1.0, -points)
    if distance.max() > CUBE_TOLERANCE:
        outside = points.flat[int(np.argmax(distance))]
        raise ValueError(f"x: expected coordinates in the unit cube [0, 1], found {outside:g}")
    largest = np.abs(responses).max()
    if largest > maxima.RESPONSE:
        raise ValueError(f"y: expected magnitudes below {maxima.RESPONSE:g}, found {largest:g}")
    return points, responses


def _first_not_finite(values: Array) -> str:
    where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
    return f"{values[where]} at index {where}"


@dataclass(frozen=True)
class Standardization:
    """Affine map of responses to zero mean and unit standard deviation.

    Attributes
    ----------
    shift, scale : float
        Standardized response = (response - shift) / scale, in the unit of the response.
    """

    shift: float
    scale: float

    @classmethod
    def of(cls, y: Array) -> Self:
        """Build the map from all observations y (N,), which are finite, each with weight one.

        Constant responses are divided by their magnitude instead of their standard deviation, so
        that the model's uncertainty is of the order of the response itself.
        """
        # Sorted, so that the rounding does not depend on the order of the observations.
        ordered = np.sort(y)
        magnitude = max(abs(ordered[0]), abs(ordered[-1]))
        if magnitude < SMALLEST_SCALE:
            return cls(0.0, 1.0)
        shift, scale = float(ordered.mean()), float(ordered.std())
        if scale <= CONSTANT_FRACTION * magnitude or scale < SMALLEST_SCALE:
            scale = float(magnitude)
        return cls(shift, scale)

    def apply(self, y: Array) -> Array:
        """Return the standardized responses, shape as `y`."""
        return (y - self.shift) / self.scale

    def restore(self, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Return a standardized mean and variance in the units of the response."""
        return self.shift + self.scale * mean, self.scale**2 * variance


@dataclass(frozen=True, eq=False)
class Replicates:
    """Observations grouped by equal x: all that a homoscedastic Gaussian likelihood needs.

    Attributes
    ----------
    x : ndarray, shape (n, d)
        Distinct points in lexicographic order.
    mean : ndarray, shape (n,)
        Mean response ȳ_i of each point.
    count : ndarray, shape (n,)
        Number of observations r_i of each point.
    sum_of_squares : float
        Σ_i Σ_j (y_ij - ȳ_i)², the within-group sum of squares.
    index : ndarray of int, shape (N,)
        Row of `x` that each original observation belongs to.
    """

    x: Array
    mean: Array
    count: Array
    sum_of_squares: float
    index: NDArray[np.intp]

    @property
    def observations(self) -> int:
        """Number N of observations."""
        return len(self.index)

    @classmethod
    def group(cls, x: ArrayLike, y: ArrayLike) -> Self:
        """Group observations, x (N, d) and y (N,), whose points are equal to the last bit.

        The result, rounding included, does not depend on the order of the observations
        (`index` apart).

        Raises
        ------
        ValueError
            As `checked_data`.
        """
        points, responses = checked_data(x, y)
        order = np.lexsort((responses, *points.T[::-1]))
        points, responses = points[order], responses[order]
        is_new = np.ones(len(points), dtype=bool)
        is_new[1:] = (points[1:] != points[:-1]).any(axis=1)
        first = np.flatnonzero(is_new)
        count = np.diff(first, append=len(points))
        mean = np.add.reduceat(responses, first) / count
        group = np.cumsum(is_new) - 1
        index = np.empty(len(points), dtype=np.intp)
        index[order] = group
        deviation = responses - mean[group]
        return cls(
            x=points[first],
            mean=mean,
            count=count.astype(np.float64),
            sum_of_squares=float(deviation @ deviation),
            index=index,
        )
