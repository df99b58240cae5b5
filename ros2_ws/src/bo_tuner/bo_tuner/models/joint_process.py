"""Gaussian process over parameter set and context, with noise that differs from place to place.

One process has all evaluations of all trials as its data, repeated ones pooled, so what is learnt
in one context or at one parameter set informs the others (Krause and Ong 2011). The kernel is the
squared exponential of `bo_tuner.models.kernel`, a product of one over the parameter set and one
over the context. Predictions of a parameter set in many contexts are therefore matrix products, and
the process of the mean over contexts has a closed form (O'Hagan 1991).

The hyperparameters are those of a process with equal noise everywhere. Its squared residuals, each
divided by its expectation, are averaged with a kernel around a place (Fan and Yao 1998); the ratio
is that of the local noise variance to the common one, and the process is conditioned once more with
the local variances (one step of Kersting and others 2007).

Notation: d tuned parameters, e context variables; n distinct joint points z = (x, c) with r_i
observations each; m parameter sets and k contexts in a query.

References
----------
Fan and Yao (1998). Efficient estimation of conditional variance functions in stochastic regression.
Biometrika 85(3).
Kersting, Plagemann, Pfaff and Burgard (2007). Most likely heteroscedastic Gaussian process
regression. ICML.
Krause and Ong (2011). Contextual Gaussian process bandit optimization. NeurIPS 24.
O'Hagan (1991). Bayes-Hermite quadrature. Journal of Statistical Planning and Inference 29(3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from bo_tuner.models.categories import Coding
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors
from bo_tuner.models.kernel import MEAN_SD, correlation, jittered_cholesky, latent_covariance
from bo_tuner.models.replicates import Replicates, Standardisation
from bo_tuner.numerics.arrays import Array

WIDTH = 0.2
"""Width of the kernel around a place whose noise is estimated, in edges of the unit cube.

Along the tuned parameters it grows with √d, as typical distances do.
"""

RESTARTED = 300
"""Largest number of points up to which each fit starts anew, beside the earlier hyperparameters.

These can be a local optimum, found with less data, that takes for noise what a context variable
does. With more points that has been found out, and a fit takes long.
"""

PRIOR_DEGREES = 2.0
"""Weight of the common noise variance in a local one, in degrees of freedom."""


@dataclass(frozen=True, eq=False)
class JointProcess:
    """Posterior of a response over parameter set and context; build it by `fit` or `condition`.

    Attributes
    ----------
    hyperparameters : Hyperparameters
        In scaled units; `noise` is the common one.
    standardisation : Standardisation
        Map between responses and standardized responses.
    data : Replicates
        Standardized observations at encoded joint points.
    coding : Coding
        Of the parameters' columns.
    columns : int
        Number of the parameters' columns after the coding.
    squares, degrees : ndarray, shape (n,)
        Sum of squares of each point's observations, in common noise variances, and its degrees of
        freedom.
    factor : ndarray, shape (n, n)
        L, lower triangular: L Lᵀ = K + diag(σ_i² / r_i).
    alpha : ndarray, shape (n,)
        (K + diag(σ_i² / r_i))⁻¹ ȳ.
    warnings : tuple of str
        Numerical problems, one line each.
    """

    hyperparameters: Hyperparameters
    standardisation: Standardisation
    data: Replicates
    coding: Coding
    columns: int
    squares: Array
    degrees: Array
    factor: Array
    alpha: Array
    warnings: tuple[str, ...] = ()

    @classmethod
    def fit(
        cls,
        x: Array,
        c: Array,
        y: Array,
        *,
        coding: Coding,
        rng: np.random.Generator,
        priors: Hyperpriors | None = None,
        minimum_length_scales: Array | None = None,
        start: Sequence[float] | None = None,
    ) -> Self:
        """Fit the hyperparameters by maximum a posteriori and condition on the data.

        Parameters
        ----------
        x : ndarray, shape (N, d)
            Parameter sets in the unit cube.
        c : ndarray, shape (N, e)
            Contexts in the unit cube; e may be 0.
        y : ndarray, shape (N,)
            Responses.
        coding : Coding
            Of the parameters' columns.
        rng, priors, start
            As `GaussianProcess.fit`.
        minimum_length_scales : ndarray, shape (d,), optional
            Lower bounds of the parameters' length scales.
        """
        minimum = None
        if minimum_length_scales is not None:
            minimum = np.append(coding.spread(minimum_length_scales), np.zeros(c.shape[1]))
        process = GaussianProcess.fit(
            np.hstack([coding.encode(x), c]),
            y,
            rng=rng,
            priors=priors,
            minimum_length_scales=minimum,
            start=start,
            restart=len(y) <= RESTARTED,
        )
        return cls._localized(process, y, coding, c.shape[1])

    @classmethod
    def condition(
        cls, hyperparameters: Sequence[float], x: Array, c: Array, y: Array, *, coding: Coding
    ) -> Self:
        """Condition on data with given hyperparameters, a `warm_start` of an earlier fit."""
        process = GaussianProcess.condition(
            Hyperparameters.from_log(np.array(hyperparameters)),
            np.hstack([coding.encode(x), c]),
            y,
        )
        return cls._localized(process, y, coding, c.shape[1])

    @classmethod
    def _localized(cls, process: GaussianProcess, y: Array, coding: Coding, contexts: int) -> Self:
        data, common = process.data, process.hyperparameters.noise**2
        deviation = process.standardisation.apply(y) - data.mean[data.index]
        within = np.bincount(data.index, deviation**2, minlength=len(data.x))
        inverse = lapack.dtrtri(process.factor, lower=1)[0]
        # The residual of a mean of r observations is (σ²/r) α, and its variance under the model is
        # (σ²/r)² [C⁻¹]_ii; 1 - h_ii = (σ²/r) [C⁻¹]_ii are its degrees of freedom.
        error = common / data.count
        degrees = error * np.einsum("ij,ij->j", inverse, inverse) + data.count - 1.0
        squares = (error * process.alpha**2) + within / common
        columns = data.x.shape[1] - contexts
        local = _local_ratio(data.x, data.x, columns, squares, degrees)[0]
        covariance = latent_covariance(process.hyperparameters, data.x, data.x)
        covariance[np.diag_indices(len(data.x))] += common * local / data.count
        factor, jitter = jittered_cholesky(covariance)
        warnings = process.warnings
        if jitter > 0.0:
            warnings += (f"covariance matrix: needed {jitter:.0e} on its diagonal",)
        alpha, _ = lapack.dpotrs(factor, data.mean, lower=1)
        return cls(
            process.hyperparameters,
            process.standardisation,
            data,
            coding,
            columns,
            squares,
            degrees,
            factor,
            alpha,
            warnings,
        )

    @property
    def scale(self) -> float:
        """Standard deviation of the responses."""
        return self.standardisation.scale

    @property
    def noise_variance(self) -> float:
        """Common noise variance, in the squared unit of the response."""
        return (self.scale * self.hyperparameters.noise) ** 2

    @property
    def warm_start(self) -> tuple[float, ...]:
        """Logarithms of the hyperparameters, where a later fit starts."""
        return tuple(self.hyperparameters.to_log().tolist())

    @property
    def length_scales(self) -> Array:
        """Length scales (d + e,) in the unit cube; of a choice, the least of its columns."""
        return self.coding.least(self.hyperparameters.length_scales)

    @property
    def points(self) -> Array:
        """Distinct parameter sets (n', d) of the data, in the unit cube."""
        return self._distinct[0]

    @property
    def counts(self) -> Array:
        """Number of observations (n',) of each of `points`."""
        return self._distinct[1]

    @cached_property
    def _distinct(self) -> tuple[Array, Array]:
        encoded, index = np.unique(self.data.x[:, : self.columns], axis=0, return_inverse=True)
        return self.coding.decode(encoded), np.bincount(index.ravel(), self.data.count).astype(
            np.float64
        )

    def means(self, x: Array, contexts: Array) -> Array:
        """Return the posterior mean (m, k) of the parameter sets x (m, d) in contexts (k, e)."""
        weighted = self._context_kernel(contexts) * self.alpha[:, None]
        mean = self._parameter_kernel(x) @ weighted + MEAN_SD**2 * self.alpha.sum()
        found: Array = self.standardisation.shift + self.scale * mean
        return found

    def variances(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> Array:
        """Return the posterior variance (m,) of x (m, d), each in the context of its own row.

        Parameters
        ----------
        x : ndarray, shape (m, d)
        contexts : ndarray, shape (k, e)
        which : ndarray of int, shape (m,)
            Row of `contexts` for each parameter set.
        """
        across = self._context_kernel(contexts).T[which]
        cross = self._parameter_kernel(x) * across + MEAN_SD**2
        prior = self.hyperparameters.signal**2 + MEAN_SD**2
        return self._posterior_variance(cross, prior)

    def variance_of_mean(self, x: Array, contexts: Array) -> Array:
        """Return the posterior variance (m,) of the mean over contexts (k, e), at x (m, d)."""
        across = self._context_kernel(contexts).mean(axis=1)
        cross = self._parameter_kernel(x) * across + MEAN_SD**2
        scales = self.hyperparameters.length_scales[self.columns :]
        prior = self.hyperparameters.signal**2 * correlation(contexts, contexts, scales).mean()
        return self._posterior_variance(cross, float(prior) + MEAN_SD**2)

    def variance_of_weighted(self, x: Array, contexts: Array, weights: Array) -> Array:
        """Return the posterior variance (m,) of sums over contexts (k, e) with weights (m, k)."""
        across = weights @ self._context_kernel(contexts).T
        cross = self._parameter_kernel(x) * across + MEAN_SD**2
        scales = self.hyperparameters.length_scales[self.columns :]
        within = weights @ correlation(contexts, contexts, scales)
        prior = self.hyperparameters.signal**2 * np.einsum("ij,ij->i", within, weights)
        return self._posterior_variance(cross, prior + MEAN_SD**2)

    def noise(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the local noise variance (m,), in the squared unit, and its degrees of freedom.

        Parameters
        ----------
        x, contexts, which
            As in `variances`.
        """
        z = np.hstack([self.coding.encode(x), contexts[which]])
        ratio, degrees = _local_ratio(z, self.data.x, self.columns, self.squares, self.degrees)
        return self.noise_variance * ratio, degrees

    def noise_everywhere(self, x: Array, contexts: Array) -> tuple[Array, Array]:
        """Return as `noise`, for each of x (m, d) in all contexts (k, e); (m, k) each."""
        own, data, widths = self.coding.encode(x), self.data.x, _widths(self.columns, contexts)
        near = correlation(own, data[:, : self.columns], widths[: self.columns])
        across = correlation(data[:, self.columns :], contexts, widths[self.columns :])
        total = near @ (across * self.degrees[:, None]) + PRIOR_DEGREES
        squares = near @ (across * self.squares[:, None]) + PRIOR_DEGREES
        return self.noise_variance * squares / total, total

    def _parameter_kernel(self, x: Array) -> Array:
        """Return s² k(x, x_i), shape (m, n)."""
        scales = self.hyperparameters.length_scales[: self.columns]
        kernel = correlation(self.coding.encode(x), self.data.x[:, : self.columns], scales)
        return self.hyperparameters.signal**2 * kernel

    def _context_kernel(self, contexts: Array) -> Array:
        """Return k(c_i, c), shape (n, k)."""
        scales = self.hyperparameters.length_scales[self.columns :]
        return correlation(self.data.x[:, self.columns :], contexts, scales)

    def _posterior_variance(self, cross: Array, prior: float | Array) -> Array:
        whitened = blas.dtrmm(1.0, self._inverse_factor, cross.T, lower=1)
        variance = prior - np.einsum("ij,ij->j", whitened, whitened)
        found: Array = self.scale**2 * np.maximum(variance, 0.0)
        return found

    @cached_property
    def _inverse_factor(self) -> Array:
        inverse: Array = lapack.dtrtri(self.factor, lower=1)[0]
        return inverse


def _local_ratio(
    z: Array, points: Array, columns: int, squares: Array, degrees: Array
) -> tuple[Array, Array]:
    """Return local over common noise variance and degrees of freedom at joint points, (m,) each."""
    near = correlation(z, points, _widths(columns, points[:, columns:]))
    total = near @ degrees + PRIOR_DEGREES
    return (near @ squares + PRIOR_DEGREES) / total, total


def _widths(columns: int, contexts: Array) -> Array:
    """Return the widths of the kernel around a place whose noise is estimated, see `WIDTH`."""
    return np.append(np.full(columns, WIDTH * columns**0.5), np.full(contexts.shape[1], WIDTH))
