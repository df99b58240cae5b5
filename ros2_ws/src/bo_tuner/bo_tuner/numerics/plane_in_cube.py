"""The points of the unit cube in a plane, such as the simplex: drawn uniformly, and the nearest.

A Gibbs sampler draws two coordinates at a time, given the others: they lie on a line, on which they
are uniform. On the simplex of m coordinates it mixes in a multiple of m log m steps (Smith 2014).

References
----------
Smith (2014). A Gibbs sampler on the n-simplex. Annals of Applied Probability 24, Theorem 1.
"""

import math
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.arrays import Array

SWEEPS = 20.0
"""Steps of the sampler, as a multiple of m log m."""

BISECTIONS = 100


@dataclass(frozen=True, eq=False)
class PlaneInCube:
    """The points x of [0, 1]^m with a·x = b.

    Attributes
    ----------
    coefficients : ndarray, shape (m,)
        The vector a, without a 0.
    total : float
        b, between the sums of the negative and of the positive coefficients.
    """

    coefficients: Array
    total: float

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw points (count, m), uniformly.

        For y = |a| x, and |a| (1 - x) where a is negative, the plane is a sum of all y.
        """
        widths = np.abs(self.coefficients)
        size = len(widths)
        negative = self.coefficients < 0.0
        sum_of_y = self.total - self.coefficients[negative].sum()
        y = np.tile(widths * (sum_of_y / widths.sum()), (count, 1))
        for _ in range(math.ceil(SWEEPS * size * math.log(size + 1.0))):
            i, j = rng.choice(size, 2, replace=False)
            both = y[:, i] + y[:, j]
            least = np.maximum(both - widths[j], 0.0)
            y[:, i] = least + rng.random(count) * (np.minimum(both, widths[i]) - least)
            y[:, j] = both - y[:, i]
        x = np.clip(y / widths, 0.0, 1.0)
        return np.where(negative, 1.0 - x, x)

    def nearest(self, points: Array) -> Array:
        """Return the points (n, m) of it that are nearest to others (n, m).

        They are those of the cube nearest to z - λ a, of which a·x falls with λ.
        """
        a = self.coefficients
        reach = ((np.abs(points) + 1.0) / np.abs(a)).max(axis=1)
        low, high = -reach, reach
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            beyond = np.clip(points - middle[:, None] * a, 0.0, 1.0) @ a > self.total
            low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
        nearest: Array = np.clip(points - (0.5 * (low + high))[:, None] * a, 0.0, 1.0)
        return nearest
