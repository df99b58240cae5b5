"""Squared-exponential kernel with a constant mean, and the factor of its covariance matrices.

The prior of the standardized response's expectation at a point x of the unit cube is

    f = β + g,   β ~ N(0, MEAN_SD²),   g ~ GP(0, k),
    k(x, x') = s² exp(-½ Σ_j (x_j - x'_j)² / ℓ_j²).

The constant mean β is integrated out analytically, which adds the constant MEAN_SD² to the kernel
(Rasmussen and Williams 2006, Section 2.7). As responses are standardized, MEAN_SD = 1 is wide.
"""

import numpy as np
from scipy.linalg import blas, lapack
from scipy.spatial.distance import cdist

from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.numerics.arrays import Array

MEAN_SD = 1.0


def latent_covariance(hyperparameters: Hyperparameters, a: Array, b: Array) -> Array:
    """Return the prior covariance (m, n) of f at a (m, d) and b (n, d), constant mean included."""
    squared = scaled_squared_distances(a, b, hyperparameters.length_scales)
    return covariance_of_distances(hyperparameters, squared)


def scaled_squared_distances(a: Array, b: Array, scales: Array) -> Array:
    """Return Σ_j (a_j - b_j)² / ℓ_j² (m, n) of all pairs of a (m, d) and b (n, d).

    It is exactly zero for equal points. The `scales` are the length scales ℓ (d,).
    """
    if not len(scales):
        return np.zeros((len(a), len(b)))
    squared: Array = cdist(a / scales, b / scales, "sqeuclidean")
    return squared


def correlation(a: Array, b: Array, scales: Array) -> Array:
    """Return k(a, b) / s² (m, n) of all pairs, see `scaled_squared_distances`."""
    return np.exp(-0.5 * scaled_squared_distances(a, b, scales))


def covariance_of_distances(hyperparameters: Hyperparameters, squared: Array) -> Array:
    """Return the prior covariance of f for scaled squared distances, shape as `squared`."""
    result = np.exp(-0.5 * squared)
    result *= hyperparameters.signal**2
    result += MEAN_SD**2
    return result


def jittered_cholesky(covariance: Array) -> tuple[Array, float]:
    """Compute the Cholesky factor of a covariance matrix, with as little jitter as necessary.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Positive semi-definite up to rounding; only the lower triangle is read.

    Returns
    -------
    factor : ndarray, shape (n, n)
        Lower triangular L with L Lᵀ = covariance + jitter · I.
    jitter : float
        What was added to the diagonal, usually 0; in the unit of the covariance.

    Raises
    ------
    ValueError
        If an entry of the matrix is NaN or infinite.
    """
    n = len(covariance)
    scale = float(np.trace(covariance)) / n
    # No covariance of f exceeds its variance, the same at every point, and noise only adds to the
    # diagonal. So the last jitter makes the matrix positive definite.
    for rung in (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 2.0 * n):
        matrix = np.array(covariance, order="F")
        matrix[np.diag_indices(n)] += rung * scale
        factor, info = lapack.dpotrf(matrix, lower=1, clean=1, overwrite_a=1)
        if info == 0:
            return factor, rung * scale
    raise ValueError("covariance: expected finite entries, found NaN or infinity")


def cholesky_factor(covariance: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the factor of `jittered_cholesky`, and a warning if the matrix needed jitter."""
    factor, jitter = jittered_cholesky(covariance)
    if jitter == 0.0:
        return factor, ()
    return factor, (f"covariance matrix: needed {jitter:.0e} on its diagonal",)


def squared_norms(whitening: Array, cross: Array) -> Array:
    """Return ‖W c_i‖² (m,) of the rows c_i of `cross` (m, n), for W (n, n) lower triangular."""
    whitened = blas.dtrmm(1.0, whitening, cross.T, lower=1)
    norms: Array = np.einsum("ij,ij->j", whitened, whitened)
    return norms
