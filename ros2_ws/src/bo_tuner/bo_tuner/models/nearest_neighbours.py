"""Probability of a class, estimated from the nearest neighbours.

Used twice in the acquisition function (paper, Eq. 5): for p_out, labels from the outlier detection,
and for p_fail, labels from crashes.

The paper's footnote specifies "a squared exponential kernel as distance metric and a squared
inverse distance weighting". Here the distance is the one that the kernel induces in its feature
space, with k(x, x') = exp(-½ Σ_j (x_j - x'_j)² / ℓ_j²):

    δ(x, x')² = k(x, x) - 2 k(x, x') + k(x', x') = 2 (1 - k(x, x')).

It is a metric: close to the Euclidean one (in length scales) for near points, and saturating at √2
for distant ones, which all count the same. A neighbour's weight is 1 / δ².
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from bo_tuner.numerics.arrays import Array

FEW = 100
"""Largest number of points at which comparing with all is faster than a search tree.

Measured for the hundred particles of a swarm; both find the same neighbours.
"""


@dataclass(frozen=True, eq=False)
class NeighbourClassifier:
    """Estimate of the probability that a point belongs to the positive class.

    The k nearest neighbours vote with the weights w_i = 1 / δ_i². The prior votes as one further
    neighbour at the distance δ_0 with the class probability p_0,

        p(x) = (Σ_i w_i c_i + w_0 p_0) / (Σ_i w_i + w_0),   w_0 = 1 / δ_0²,

    which is the mean of a Beta distribution with w_0 p_0 and w_0 (1 - p_0) pseudo-counts. So one
    crash among few trials does not exclude the whole space (with the defaults p(x) < 0.4 far from a
    crash that is the only trial), while p → 1 as x approaches a crash.

    Attributes
    ----------
    x : ndarray, shape (n, d)
        Labelled points in the unit cube, n ≥ 0.
    labels : ndarray of bool, shape (n,)
        Class of each point.
    length_scales : ndarray, shape (d,)
        ℓ of the kernel, in edges of the unit cube.
    neighbours : int
        k ≥ 1; all points vote if there are fewer.
    prior_probability : float
        p_0 in [0, 1].
    encode : callable
        Maps points at which the probability is asked for, in whatever form, to points like `x`.
    prior_distance : float
        δ_0 > 0; at 1 the kernel is ½. Infinity removes the prior.

    Raises
    ------
    ValueError
        If shapes do not fit or a value is out of range.
    """

    x: Array
    labels: NDArray[np.bool_]
    length_scales: Array
    neighbours: int = 5
    prior_probability: float = 0.1
    prior_distance: float = 1.0
    encode: Callable[[Array], Array] = lambda x: x

    def __post_init__(self) -> None:
        if self.x.ndim != 2 or not np.isfinite(self.x).all():
            raise ValueError(f"x: expected finite values of shape (n, d), found {self.x.shape}")
        n, d = self.x.shape
        if self.labels.shape != (n,) or self.labels.dtype != np.bool_:
            raise ValueError(
                f"labels: expected booleans of shape ({n},), found {self.labels.dtype} "
                f"of shape {self.labels.shape}"
            )
        if self.length_scales.shape != (d,) or not (self.length_scales > 0.0).all():
            raise ValueError(
                f"length_scales: expected {d} positive values, found {self.length_scales}"
            )
        if self.neighbours < 1:
            raise ValueError(f"neighbours: expected at least 1, found {self.neighbours}")
        if not 0.0 <= self.prior_probability <= 1.0:
            raise ValueError(
                f"prior_probability: expected a value in [0, 1], found {self.prior_probability}"
            )
        if not self.prior_distance > 0.0:
            raise ValueError(f"prior_distance: expected > 0, found {self.prior_distance}")

    def probability(self, x: Array) -> Array:
        """Return p(x) (m,) at x (m, d).

        At a labelled point itself, it is its label (the mean label of equal points).
        """
        inside, outside = self._votes(x)
        return inside / (inside + outside)

    def log_complement(self, x: Array) -> Array:
        """Return log(1 - p(x)) (m,) without cancellation; -inf at positive points."""
        inside, outside = self._votes(x)
        with np.errstate(divide="ignore"):
            result: Array = np.log(outside / (inside + outside))
        return result

    @cached_property
    def _scaled(self) -> Array:
        return self.x / self.length_scales

    def _nearest(self, scaled: Array) -> NDArray[np.intp]:
        """Return the rows (m, k) of the nearest points of each of `scaled` (m, d), nearest first.

        A tie for the last place may go to either.
        """
        count = min(len(self.x), self.neighbours)
        if len(self.x) > FEW:
            rows: NDArray[np.intp] = self._tree.query(scaled, count, return_distance=False)
            return rows
        squared = cdist(scaled, self._scaled, "sqeuclidean")
        rows = np.argpartition(squared, count - 1, axis=1)[:, :count]
        order = np.argsort(np.take_along_axis(squared, rows, axis=1), axis=1)
        return np.take_along_axis(rows, order, axis=1)

    @cached_property
    def _tree(self) -> Any:
        # Its import takes longer than all others of a command together, and most runs never ask.
        from sklearn.neighbors import KDTree

        return KDTree(self._scaled)

    def _votes(self, x: Array) -> tuple[Array, Array]:
        """Return the summed weights (m,) for and against the positive class."""
        x = self.encode(x)
        n, m = len(self.x), len(x)
        prior = self.prior_distance**-2
        if n == 0:
            prior = 1.0
        inside = np.full(m, prior * self.prior_probability)
        outside = np.full(m, prior * (1.0 - self.prior_probability))
        if n == 0:
            return inside, outside
        # δ increases with the Euclidean distance, so both have the same nearest neighbours.
        scaled = x / self.length_scales
        nearest = self._nearest(scaled)
        squared = ((scaled[:, None, :] - self._scaled[nearest]) ** 2).sum(axis=2)
        labels = self.labels[nearest]
        distance = -2.0 * np.expm1(-0.5 * squared)
        # A neighbour at distance zero has infinite weight: only such neighbours count.
        coincident = distance == 0.0
        weights = 1.0 / np.where(coincident, 1.0, distance)
        decided = coincident.any(axis=1)
        weights[decided] = coincident[decided]
        inside[decided] = outside[decided] = 0.0
        inside += (weights * labels).sum(axis=1)
        outside += (weights * ~labels).sum(axis=1)
        return inside, outside
