"""Sums over the evaluations of each parameter set."""

import numpy as np

from bo_tuner.numerics.arrays import Array


class ParameterSets:
    """The q distinct parameter sets of n joint points.

    Parameters
    ----------
    z : ndarray, shape (n, columns + e)
        Joint points in an order in which those of a parameter set follow each other.
    columns : int
        Number of the parameters' columns, the first ones.

    Attributes
    ----------
    distinct : ndarray, shape (q, columns)
        The parameter sets.
    """

    def __init__(self, z: Array, columns: int) -> None:
        x = z[:, :columns]
        begins = np.ones(len(z), dtype=bool)
        begins[1:] = (x[1:] != x[:-1]).any(axis=1)
        self._starts = np.flatnonzero(begins)
        self._owners = np.cumsum(begins) - 1
        self.distinct: Array = x[self._starts]

    def sum(self, values: Array, axis: int = 0) -> Array:
        """Return the sums of values (…, n, …) over the points of each set, shape (…, q, …)."""
        sums: Array = np.add.reduceat(values, self._starts, axis=axis)
        return sums

    def spread(self, values: Array) -> Array:
        """Return values (m, q) of the sets at their points, shape (m, n)."""
        spread: Array = values[:, self._owners]
        return spread
