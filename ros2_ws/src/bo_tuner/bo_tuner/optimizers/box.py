"""Part of the unit cube that a search is confined to."""

from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube


@dataclass(frozen=True, eq=False)
class Box:
    """Part of the unit cube that a search is confined to.

    Attributes
    ----------
    lower, upper : ndarray, shape (d,)
        Its bounds.
    """

    lower: Array
    upper: Array

    def nearest(self, points: Array) -> Array:
        """Return the points (m, d) of the box that are nearest to points (m, d)."""
        return np.clip(points, self.lower, self.upper)

    def latin_hypercube(self, count: int, rng: np.random.Generator) -> Array:
        """Draw points (count, d)."""
        spread = latin_hypercube(count, len(self.lower), rng)
        points: Array = self.lower + (self.upper - self.lower) * spread
        return points
