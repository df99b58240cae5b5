"""Posterior of a Gaussian process whose observations each have a noise variance of their own.

Up to `BASIS` points it is exact. With more, it is the projected process on a basis of that many of
them (Quiñonero-Candela and Rasmussen 2005, the deterministic training conditional, with the
variance of the posterior that Titsias, 2009, shows to be optimal for a given basis): an n × n
covariance is replaced by its Nyström approximation, and the time grows with n instead of n³. The
basis is chosen greedily, by a pivoted Cholesky factorization (Burt and others 2020): each further
point is the one that the basis so far explains worst, in units of its noise.

Notation: n points with the means ȳ of their observations, whose noise variances are Λ = diag(λ);
K their prior covariance; m points u of the basis.

References
----------
Burt, Rasmussen and van der Wilk (2020). Convergence of sparse variational inference in Gaussian
processes regression. JMLR 21(131).
Quiñonero-Candela and Rasmussen (2005). A unifying view of sparse approximate Gaussian process
regression. JMLR 6.
Titsias (2009). Variational learning of inducing variables in sparse Gaussian processes. AISTATS.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.kernel import MEAN_SD, cholesky_factor, latent_covariance
from bo_tuner.numerics.arrays import Array

BASIS = 1000
"""Largest number of points of the basis.

With 400, a thousand trials with three evaluations each had errors of the mean of several standard
deviations; and to choose a basis of many takes longer than to do without one.
"""

EXPLAINED = 1e-3
"""Part of a point's noise variance, or of the prior's, below which its own variance is explained.

That is the variance which the basis leaves: what it explains needs no point of its own.
"""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the standardized response.

    Attributes
    ----------
    basis : ndarray, shape (m, d)
        u.
    weights : ndarray, shape (m,)
        The mean at z is k(z, u) @ weights.
    whitening : ndarray, shape (m, m)
        W, lower triangular: the variance at z is k(z, z) - ‖W k(u, z)‖².
    residuals : ndarray, shape (n,)
        ȳ less the mean at the points.
    leverages : ndarray, shape (n,)
        h_i: part of the mean at the i-th point that its own ȳ_i contributes.
    variances : ndarray, shape (n,)
        λ.
    warnings : tuple of str
        Numerical problems, one line each.
    """

    basis: Array
    weights: Array
    whitening: Array
    residuals: Array
    leverages: Array
    variances: Array
    warnings: tuple[str, ...]


def choose_basis(
    hyperparameters: Hyperparameters, x: Array, variances: Array
) -> NDArray[np.intp] | None:
    """Return the rows (m,) of the basis in x (n, d), in its order; None if the posterior is exact.

    Parameters
    ----------
    hyperparameters
        Of the kernel; their noise is not used.
    x : ndarray, shape (n, d)
        Distinct points.
    variances : ndarray, shape (n,)
        Noise variances of the means observed there.
    """
    if len(x) <= BASIS:
        return None
    prior = hyperparameters.signal**2 + MEAN_SD**2
    left = np.full(len(x), prior)
    rows: list[int] = []
    v = np.zeros((len(x), BASIS), order="F")
    for column in range(BASIS):
        pivot = int((left / variances).argmax())
        if left[pivot] <= EXPLAINED * min(variances[pivot], prior):
            break
        covariance = latent_covariance(hyperparameters, x, x[[pivot]])[:, 0]
        v[:, column] = (covariance - v[:, :column] @ v[pivot, :column]) / np.sqrt(left[pivot])
        left = np.maximum(left - v[:, column] ** 2, 0.0)
        left[pivot] = 0.0
        rows.append(pivot)
    return np.sort(rows)


class Prior:
    """Prior of `bo_tuner.models.kernel` at the points of data, to be conditioned on them.

    Parameters
    ----------
    hyperparameters
        Of the kernel; their noise is not used.
    x : ndarray, shape (n, d)
        Distinct points.
    basis : ndarray of int, shape (m,), or None
        Rows of x; without them the posterior is exact.
    """

    def __init__(
        self, hyperparameters: Hyperparameters, x: Array, basis: NDArray[np.intp] | None
    ) -> None:
        self._basis = x if basis is None else x[basis]
        self._exact = basis is None
        self._covariance = latent_covariance(hyperparameters, self._basis, self._basis)
        if not self._exact:
            factor, self._warnings = cholesky_factor(self._covariance)
            self._whitening = lapack.dtrtri(factor, lower=1)[0]
            cross = latent_covariance(hyperparameters, x, self._basis)
            self._v = cross @ self._whitening.T  # K ≈ V Vᵀ

    def condition(self, mean: Array, variances: Array) -> Posterior:
        """Condition on data.

        Parameters
        ----------
        mean : ndarray, shape (n,)
            ȳ.
        variances : ndarray, shape (n,)
            λ > 0.
        """
        if self._exact:
            return self._exactly(mean, variances)
        return self._projected(mean, variances)

    def _exactly(self, mean: Array, variances: Array) -> Posterior:
        covariance = self._covariance.copy()
        covariance[np.diag_indices(len(mean))] += variances
        factor, warnings = cholesky_factor(covariance)
        weights, _ = lapack.dpotrs(factor, mean, lower=1)
        whitening = lapack.dtrtri(factor, lower=1)[0]
        own = np.einsum("ij,ij->j", whitening, whitening)
        left, leverages = variances * weights, 1.0 - variances * own
        return Posterior(self._basis, weights, whitening, left, leverages, variances, warnings)

    def _projected(self, mean: Array, variances: Array) -> Posterior:
        v = self._v
        precise = v / variances[:, None]
        inner = v.T @ precise
        inner[np.diag_indices(len(inner))] += 1.0
        factor, warnings = cholesky_factor(inner)
        latent, _ = lapack.dpotrs(factor, precise.T @ mean, lower=1)
        explained = -lapack.dpotri(factor, lower=1)[0]
        explained[np.diag_indices(len(explained))] += 1.0
        # Its factor Fᵀ F with F lower triangular is a Cholesky factor in reversed order.
        reverse, further = cholesky_factor(explained[::-1, ::-1].T)
        own = lapack.dtrtrs(factor, v.T, lower=1)[0]
        return Posterior(
            self._basis,
            self._whitening.T @ latent,
            reverse[::-1, ::-1].T @ self._whitening,
            mean - v @ latent,
            np.einsum("ij,ij->j", own, own) / variances,
            variances,
            self._warnings + warnings + further,
        )
