"""Mean and reduction of the variance in given contexts, by a posterior over joint points.

The kernel is a product, s² k(x, x') k(c, c'), and several points (u_i, c_i) of the basis have the
same parameter set u. What predictions need of the contexts is therefore computed once, and with
g(x), the s² k(x, u) of the distinct parameter sets, and a 1 for the constant mean:

- the mean at x in a context is the product of g with sums of weights;
- the reduction of the variance is ‖W k‖² (`Posterior.whitening`) with k_i = s² k(x, u_i) a_i +
  MEAN_SD², a_i = k(c_i, c). As k is linear in g, W k = M g with a matrix M that has a column for
  each parameter set, and ‖W k‖² = ‖R g‖² with the triangular R of M = Q R. (Mᵀ M takes less time
  than R, and loses half of the digits of a small variance.)

Notation: b points of the basis, of q distinct parameter sets; k contexts; m parameter sets that are
asked for.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from bo_tuner.models.conditioning import Posterior
from bo_tuner.models.kernel import MEAN_SD, squared_norms
from bo_tuner.models.parameter_sets import ParameterSets
from bo_tuner.numerics.arrays import Array

WORTH_A_FACTOR = 300
"""Number of variances in a context after which its own R is worth the time that it takes."""

NOISY = 1e-6
"""Least noise variance, in prior variances, with which R is used.

The error of a small variance grows with the inverse of that ratio, faster for R than for W: at
5e-9 it was measured to be 4e-3 against 5e-4 of the variance, at 7e-8 3e-4 against 1e-5.
"""


class ContextReduction:
    """What predictions in given contexts need, whatever the parameter set.

    Contexts of which many variances are asked for get a factor R of their own; before and after
    that, the variances agree to their accuracy.

    Parameters
    ----------
    posterior
        Over joint points.
    sets
        The parameter sets of its basis.
    across : ndarray, shape (b, k)
        k(c_i, c).
    prior : float
        Prior variance.

    Attributes
    ----------
    weights : ndarray, shape (q, k)
        The mean at x is s² k(x, u) @ weights, less that of the constant.
    """

    def __init__(
        self, posterior: Posterior, sets: ParameterSets, across: Array, prior: float
    ) -> None:
        self._whitening = posterior.whitening
        self._sets = sets
        self._across = across
        # The mean over all contexts is another column.
        self._columns = np.column_stack([across, across.mean(axis=1)])
        self._mean = across.shape[1]
        self._asked = np.zeros(self._mean + 1, dtype=np.intp)
        self._factors: dict[int, Array] = {}
        few_sets = 2 * len(sets.distinct) <= len(across)
        self._factors_pay = few_sets and bool(posterior.variances.min() >= NOISY * prior)
        self.weights = sets.sum(across * posterior.weights[:, None])

    def of_each(self, kernel: Array, which: NDArray[np.intp]) -> Array:
        """Return the reductions (m,) by s² k(x, u) (m, q), each in the context of its own row."""
        self._asked += np.bincount(which, minlength=len(self._asked))
        factored = self._factors_pay & (self._asked > WORTH_A_FACTOR)[which]
        reduction = np.empty(len(kernel))
        for column in np.unique(which[factored]):
            rows = which == column
            extended = np.vstack([kernel[rows].T, np.ones(rows.sum())])
            reduced = blas.dtrmm(1.0, self._factor(column), extended)
            reduction[rows] = np.einsum("ij,ij->j", reduced, reduced)
        direct = ~factored
        reduction[direct] = self._reduced(kernel[direct], self._columns.T[which[direct]])
        return reduction

    def of_mean(self, kernel: Array) -> Array:
        """Return the reductions (m,) for the mean over all contexts."""
        return self.of_each(kernel, np.full(len(kernel), self._mean))

    def of_sums(self, kernel: Array, weights: Array, total: float = 1.0) -> Array:
        """Return the reductions (m,) for sums over the contexts with weights (m, k).

        The weights of each row add up to `total`.
        """
        return self._reduced(kernel, weights @ self._across.T, total)

    def _reduced(self, kernel: Array, across: Array, total: float = 1.0) -> Array:
        """Return ‖W k‖² (m,), for sums over contexts of their k(c_i, c), across (m, b)."""
        cross = self._sets.spread(kernel) * across + total * MEAN_SD**2
        return squared_norms(self._whitening, cross)

    def _factor(self, column: int) -> Array:
        """Return R (q + 1, q + 1), upper triangular, of a context or of the mean over all."""
        if column not in self._factors:
            matrix = self._sets.sum(self._whitening * self._columns[:, column], axis=1)
            constant = MEAN_SD**2 * self._whitening.sum(axis=1)
            factored, _, _, _ = lapack.dgeqrf(np.column_stack([matrix, constant]))
            self._factors[column] = np.triu(factored[: factored.shape[1]])
        return self._factors[column]
