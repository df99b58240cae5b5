"""Gaussian process with a constant mean, a squared-exponential kernel and Gaussian noise.

Model of a standardized response at a point x of the unit cube: y = f(x) + ε, ε ~ N(0, σ²), with
the prior of f in `bo_tuner.models.kernel` (paper, Section 3).

Notation: n distinct points with r_i observations each; K the n × n prior covariance,
C = K + σ² diag(1 / r) = L Lᵀ, α = C⁻¹ ȳ.

References
----------
Rasmussen and Williams (2006). Gaussian Processes for Machine Learning. MIT Press.
Forrester, Keane and Bressloff (2006). Design and analysis of "noisy" computer experiments.
AIAA Journal 44(10): reinterpolation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from bo_tuner.models.compression import NO_COMPRESSION, Compression
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors
from bo_tuner.models.kernel import (
    MEAN_SD,
    cholesky_factor,
    covariance_of_distances,
    jittered_cholesky,
    latent_covariance,
    scaled_squared_distances,
    squared_norms,
)
from bo_tuner.models.log_posterior import LogPosterior, maximize_posterior
from bo_tuner.models.replicates import Replicates, Standardization, checked_data
from bo_tuner.numerics.arrays import Array

# Below this fraction of the prior variance, the variance of an interpolating model is rounding.
INTERPOLATION_RESOLUTION = 1e-9


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """Gaussian process conditioned on data; build it by `fit` or `condition`.

    Methods raise `ValueError` for points that do not have the d columns of the data.

    Attributes
    ----------
    hyperparameters : Hyperparameters
        In scaled units.
    standardization : Standardization
        Map between responses and standardized responses.
    data : Replicates
        Standardized observations; shapes (n, d), (n,).
    factor : ndarray, shape (n, n)
        L, lower triangular.
    alpha : ndarray, shape (n,)
        α = C⁻¹ ȳ.
    warnings : tuple of str
        Numerical problems of the fit, one line each; usually empty.
    """

    hyperparameters: Hyperparameters
    standardization: Standardization
    data: Replicates
    factor: Array
    alpha: Array
    warnings: tuple[str, ...] = ()

    @property
    def compression(self) -> Compression:
        """None: predictions are in the response's unit."""
        return NO_COMPRESSION

    @classmethod
    def fit(
        cls,
        x: ArrayLike,
        y: ArrayLike,
        *,
        rng: np.random.Generator,
        priors: Hyperpriors | None = None,
        minimum_length_scales: ArrayLike | None = None,
        start: Sequence[float] | None = None,
        restart: bool = False,
        keep: bool = False,
    ) -> Self:
        """Fit the hyperparameters by maximum a posteriori and condition on the data.

        Parameters
        ----------
        x : array_like, shape (N, d)
            Points in the unit cube; equal rows are replicates.
        y : array_like, shape (N,)
            Responses.
        rng : numpy.random.Generator
            Draws further starting points besides a warm start, see `maximize_posterior`.
        priors : Hyperpriors, optional
            Priors of the hyperparameters; by default `Hyperpriors.default`.
        minimum_length_scales : array_like, shape (d,), optional
            Lower bounds of the length scales, in edges of the unit cube.
        start : sequence of float, length d + 2, optional
            `warm_start` of an earlier fit to similar data.
        restart : bool
            Whether the fit also starts as without `start`, see `maximize_posterior`.
        keep : bool
            Whether the hyperparameters of `start` are kept as they are.

        Raises
        ------
        ValueError
            If the data, the bounds or the length of `start` are invalid. Numerical problems raise
            nothing; they are listed in `warnings`.
        """
        points, responses = checked_data(x, y)
        dimension = points.shape[1]
        priors = Hyperpriors.default(dimension) if priors is None else priors
        box = priors.bounds(dimension, minimum_length_scales)
        if start is not None and len(start) != dimension + 2:
            raise ValueError(f"start: expected {dimension + 2} values, found {len(start)}")
        standardization = Standardization.of(responses)
        data = Replicates.group(points, standardization.apply(responses))
        warm = None
        if start is not None:
            earlier = Hyperparameters.from_log(np.array(start))
            if keep:
                return cls._build(earlier, standardization, data, ())
            # The round trip through exp rounds, as it did in recorded runs: without it, the search
            # would start elsewhere and the proposals would differ.
            warm = earlier.to_log()
        posterior = LogPosterior(data, priors)
        phi, warnings = maximize_posterior(posterior, box, rng, warm, restart=restart)
        return cls._build(Hyperparameters.from_log(phi), standardization, data, warnings)

    @classmethod
    def condition(
        cls,
        hyperparameters: Hyperparameters,
        x: ArrayLike,
        y: ArrayLike,
        standardization: Standardization | None = None,
    ) -> Self:
        """Condition on data, x (N, d) and y (N,), with given hyperparameters.

        They refer to the `standardization`, by default that of `y`.

        Raises
        ------
        ValueError
            If the data are invalid or the number of length scales is not d.
        """
        points, responses = checked_data(x, y)
        if hyperparameters.length_scales.shape != points.shape[1:]:
            raise ValueError(
                f"hyperparameters: expected {points.shape[1]} length scales, "
                f"found {hyperparameters.length_scales.shape}"
            )
        if standardization is None:
            standardization = Standardization.of(responses)
        data = Replicates.group(points, standardization.apply(responses))
        return cls._build(hyperparameters, standardization, data, ())

    @classmethod
    def _build(
        cls,
        hyperparameters: Hyperparameters,
        standardization: Standardization,
        data: Replicates,
        warnings: tuple[str, ...],
    ) -> Self:
        covariance = latent_covariance(hyperparameters, data.x, data.x)
        covariance[np.diag_indices(len(data.x))] += hyperparameters.noise**2 / data.count
        factor, further = cholesky_factor(covariance)
        alpha, _ = lapack.dpotrs(factor, data.mean, lower=1)
        return cls(hyperparameters, standardization, data, factor, alpha, warnings + further)

    @property
    def points(self) -> Array:
        """Distinct points of the data, shape (n, d)."""
        return self.data.x

    @property
    def counts(self) -> Array:
        """Number of observations at each point, shape (n,)."""
        return self.data.count

    @property
    def length_scales(self) -> Array:
        """Length scales, shape (d,), in edges of the unit cube."""
        return self.hyperparameters.length_scales

    @property
    def scale(self) -> float:
        """Standard deviation of the responses, by which they are standardized."""
        return self.standardization.scale

    @property
    def warm_start(self) -> tuple[float, ...]:
        """Logarithms of the hyperparameters, length d + 2, see `Hyperparameters.to_log`."""
        return tuple(self.hyperparameters.to_log().tolist())

    @property
    def noise_variance(self) -> float:
        """Variance of one observation's noise, in the squared unit of the response."""
        return (self.standardization.scale * self.hyperparameters.noise) ** 2

    @property
    def _prior_variance(self) -> float:
        return self.hyperparameters.signal**2 + MEAN_SD**2

    def predict(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance ≥ 0 (m,) of the latent response f at x (m, d).

        They are in the unit of the response and in its square, without the noise of an observation.
        """
        cross = latent_covariance(self.hyperparameters, self._checked(x), self.data.x)
        variance = self._prior_variance - squared_norms(self._inverse_factor, cross)
        return self.standardization.restore(cross @ self.alpha, np.maximum(variance, 0.0))

    def predict_mean(self, x: ArrayLike) -> Array:
        """Return the mean (m,) alone at x (m, d); cheaper than `predict`."""
        cross = latent_covariance(self.hyperparameters, self._checked(x), self.data.x)
        mean: Array = self.standardization.shift + self.standardization.scale * (cross @ self.alpha)
        return mean

    def predict_reinterpolated(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return as `predict`, by the noise-free model through the posterior means at the data.

        Interpolating the vector K C⁻¹ ȳ with the same kernel gives k(x)ᵀ K⁻¹ K C⁻¹ ȳ, the
        posterior mean of this model again; only the variance changes, to that of an interpolator
        (Forrester et al. 2006). It is exactly zero at the data. Forrester re-estimates the process
        variance from the interpolated values; here it stays the fitted one, so that both models
        share a prior.
        """
        points = self._checked(x)
        scales = self.hyperparameters.length_scales
        squared = scaled_squared_distances(points, self.data.x, scales)
        at_data = squared.min(axis=1) == 0.0
        cross = covariance_of_distances(self.hyperparameters, squared)
        variance = self._prior_variance - squared_norms(self._inverse_interpolator, cross)
        at_data |= variance <= INTERPOLATION_RESOLUTION * self._prior_variance
        variance[at_data] = 0.0
        return self.standardization.restore(cross @ self.alpha, variance)

    def _checked(self, x: ArrayLike) -> Array:
        points = np.asarray(x, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.data.x.shape[1]:
            raise ValueError(f"x: expected shape (m, {self.data.x.shape[1]}), found {points.shape}")
        return points

    # The acquisition search predicts hundreds of times from one fit: a product with the inverse
    # factor takes half the time of a triangular solve.
    @cached_property
    def _inverse_factor(self) -> Array:
        inverse: Array = lapack.dtrtri(self.factor, lower=1)[0]
        return inverse

    @cached_property
    def _inverse_interpolator(self) -> Array:
        kernel = latent_covariance(self.hyperparameters, self.data.x, self.data.x)
        # Without noise, close points make the matrix singular to rounding, so it gets a jitter well
        # below the resolution; `jittered_cholesky` adds more if that is too little.
        kernel[np.diag_indices(len(kernel))] += (
            0.1 * INTERPOLATION_RESOLUTION * self._prior_variance
        )
        factor, _ = jittered_cholesky(kernel)
        inverse: Array = lapack.dtrtri(factor, lower=1)[0]
        return inverse
