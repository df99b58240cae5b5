"""Order constraints x_i <= x_j between the columns of an array."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array


class PartialOrder:
    """A set of constraints x_i <= x_j on rows of d values.

    Parameters
    ----------
    dimension : int
        Number of columns, d.
    pairs : sequence of (int, int)
        Columns (i, j), i not j.
    """

    def __init__(self, dimension: int, pairs: Sequence[tuple[int, int]]) -> None:
        self.pairs = tuple(dict.fromkeys(pairs))
        # below[i, j]: x_i <= x_j follows from the pairs (Warshall 1962).
        self._below = np.eye(dimension, dtype=np.bool_)
        for i, j in self.pairs:
            self._below[i, j] = True
        for k in range(dimension):
            self._below |= np.outer(self._below[:, k], self._below[k])

    def implies(self, i: int, j: int) -> bool:
        """Whether x_i <= x_j follows from the constraints; true for i = j."""
        return bool(self._below[i, j])

    def tighten(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Tighten `lower` and `upper` to what the constraints permit; all have shape (d,).

        The order can be satisfied if and only if no returned lower bound exceeds its upper bound;
        clipping an ordered row to the returned bounds keeps it ordered.
        """
        below = self._below
        return (
            np.where(below, lower[:, None], -np.inf).max(axis=0, initial=-np.inf),
            np.where(below, upper[None, :], np.inf).min(axis=1, initial=np.inf),
        )

    def satisfied(self, values: Array) -> NDArray[np.bool_]:
        """Return for each row of `values`, shape (n, d), whether it is ordered, shape (n,)."""
        ordered = np.ones(len(values), dtype=np.bool_)
        for i, j in self.pairs:
            ordered &= values[:, i] <= values[:, j]
        return ordered

    def project(self, values: Array) -> Array:
        """Return ordered rows close to `values`, shape (n, d); ordered rows stay as they are.

        Each value becomes the mean of the largest value that must not exceed it and the smallest
        that it must not exceed, itself included; both of these are ordered. Two values in the wrong
        order both become their mean, which is the nearest ordered pair.
        """
        if not self.pairs:
            return values
        below = self._below[None, :, :]
        floor: Array = np.where(below, values[:, :, None], -np.inf).max(axis=1)
        ceiling: Array = np.where(below, values[:, None, :], np.inf).min(axis=2)
        # Halved first: the sum of two large values could overflow.
        return 0.5 * floor + 0.5 * ceiling

    def swap(self, values: Array) -> Array:
        """Return rows of `values`, shape (n, d), with values exchanged until they are ordered.

        Unlike `project`, this makes no two values equal, so a random design stays spread out.
        Values within the bounds of `tighten` stay within them.
        """
        ordered = values.copy()
        while not np.all(self.satisfied(ordered)):
            for i, j in self.pairs:
                wrong = ordered[:, i] > ordered[:, j]
                ordered[wrong, i], ordered[wrong, j] = ordered[wrong, j], ordered[wrong, i]
        return ordered
