"""Moves parameter sets that break a condition to the edge of the permitted region."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array

BISECTIONS = 30
"""Of the way to a permitted parameter set, which gives the edge to 1e-9 of the way."""


class Conforming:
    """Moves rows of values straight towards rows that are known to satisfy the conditions.

    The region that the conditions leave need not be convex, nor in one piece. Where it is convex,
    the way to the nearest of many points in it ends near the nearest point of its edge.

    In the shapes, d is the number of tuned parameters. Their values are in their own units.

    Parameters
    ----------
    holds : callable
        Returns which rows (n, d) satisfy the conditions, shape (n,).
    to_unit : callable
        Maps rows (n, d) to points (n, d) of the unit cube.
    to_values : callable
        Maps points (n, d) to rows (n, d) that are permitted, but may break a condition.
    anchors : ndarray, shape (m, d)
        Rows that satisfy the conditions, spread over all that do.
    unordered : ndarray of bool, shape (d,)
        Columns of choices: any two different choices are equally far apart.
    """

    def __init__(
        self,
        holds: Callable[[Array], NDArray[np.bool_]],
        to_unit: Callable[[Array], Array],
        to_values: Callable[[Array], Array],
        anchors: Array,
        unordered: NDArray[np.bool_],
    ) -> None:
        self._holds = holds
        self._to_unit = to_unit
        self._to_values = to_values
        self._anchors = anchors
        self._unordered = unordered

    def moved(self, values: Array) -> Array:
        """Return rows (n, d) that satisfy the conditions; those that do stay as they are."""
        wrong = ~self._holds(values)
        if not wrong.any():
            return values
        rows = values.copy()
        rows[wrong] = self.towards(self._nearest(values[wrong]), values[wrong])
        return rows

    def towards(self, inside: Array, outside: Array) -> Array:
        """Return rows (n, d) between some that satisfy the conditions and others that do not.

        They satisfy the conditions, as near to `outside` as a bisection of the way gets.
        """
        start = self._to_unit(inside)
        direction = self._to_unit(outside) - start
        rows = inside.copy()
        near, far = np.zeros(len(inside)), np.ones(len(inside))
        for _ in range(BISECTIONS):
            middle = 0.5 * (near + far)
            tried = self._to_values(start + middle[:, None] * direction)
            good = self._holds(tried)
            rows[good] = tried[good]
            near, far = np.where(good, middle, near), np.where(good, far, middle)
        return rows

    def _nearest(self, values: Array) -> Array:
        """Return the anchors (n, d) that are the nearest to rows (n, d)."""
        points, anchors = self._to_unit(values), self._to_unit(self._anchors)
        a, b = points[:, ~self._unordered], anchors[:, ~self._unordered]
        # Squared distances without the squared length of a, which is the same for all anchors.
        apart = (b**2).sum(axis=1) - 2.0 * a @ b.T
        for column in np.flatnonzero(self._unordered):
            apart += points[:, [column]] != anchors[:, column]
        nearest: Array = self._anchors[apart.argmin(axis=1)]
        return nearest
