"""The mean of a metric over the context, sampled from its posterior.

A band from one fitted process is too narrow: it takes for known over what distance the metric
changes and how large its noise is, and with the squared-exponential kernel also that it has all
derivatives. Here the hyperparameters φ are sampled from their posterior, one after the other, by
slice sampling (Neal 2003, Murray and Adams 2010), and the kernel is the Matérn kernel with the
smoothness 3/2, which assumes one derivative. The noise is local: its ratio to the common variance
is that of `bo_tuner.models.pooled_process`.

Notation: n distinct contexts in the unit cube with r_i observations each and their mean ȳ_i; noise
variances σ² ρ_i; K the prior covariance, C = K + σ² diag(ρ / r) = L Lᵀ, α = C⁻¹ ȳ.

References
----------
Murray and Adams (2010). Slice sampling covariance hyperparameters of latent Gaussian models.
NeurIPS 23.
Neal (2003). Slice sampling. The Annals of Statistics 31(3).
Rasmussen and Williams (2006). Gaussian Processes for Machine Learning. MIT Press.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, solve_triangular

from bo_tuner.models.categories import Coding
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors, LogNormal
from bo_tuner.models.kernel import MEAN_SD, jittered_cholesky, scaled_squared_distances
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.numerics.arrays import Array

PRIORS = Hyperpriors(
    length_scale=LogNormal(0.7, 0.7, 0.05, 20.0),
    signal=LogNormal(1.0, 0.7, 0.05, 20.0),
    noise=LogNormal(0.15, 1.0, 1e-3, 3.0),
)
"""Wider than those of a search, which only has to find where to look next."""

BURN_IN, KEPT = 5, 20
"""Sweeps over all hyperparameters before the first that is kept, and those that are."""

WIDTH = 1.0
"""Width of a slice before it is stepped out, in logarithms."""


@dataclass(frozen=True, eq=False)
class _Conditioned:
    """A process with given hyperparameters, conditioned on the data; `value` is log p(φ | data)."""

    phi: Array
    value: float
    factor: Array
    alpha: Array

    @property
    def hyperparameters(self) -> Hyperparameters:
        return Hyperparameters.from_log(self.phi)


class ContextResponse:
    """Posterior of the mean of a metric over the context, a mixture of `KEPT` processes."""

    def __init__(self, points: Array, values: Array, rng: np.random.Generator) -> None:
        fitted = PooledProcess.fit(
            np.empty((len(points), 0)), points, values, coding=Coding(()), rng=rng, priors=PRIORS
        )
        self._standardization, self._data = fitted.standardization, fitted.data
        n = len(self._data.x)
        local, _ = fitted.noise(np.empty((n, 0)), self._data.x, np.arange(n))
        self._ratio = local / fitted.noise_variance
        deviation = self._standardization.apply(values) - self._data.mean[self._data.index]
        within = np.bincount(self._data.index, deviation**2, minlength=n)
        self._sum_of_squares = float((within / self._ratio).sum())
        self._box = PRIORS.bounds(points.shape[1]).T
        self._mixture = self._sample(np.clip(fitted.hyperparameters.to_log(), *self._box), rng)

    def mean(self, x: Array) -> Array:
        """Return the posterior mean (m,) at contexts x (m, e) of the unit cube."""
        means = [_covariance(p.hyperparameters, x, self._data.x) @ p.alpha for p in self._mixture]
        mean: Array = self._standardization.shift + self._standardization.scale * np.mean(
            means, axis=0
        )
        return mean

    def sample(self, x: Array, count: int, rng: np.random.Generator) -> Array:
        """Draw the mean jointly at contexts x (m, e) of the unit cube."""
        samples = []
        for process in self._mixture:
            theta = process.hyperparameters
            cross = _covariance(theta, self._data.x, x)
            whitened = solve_triangular(process.factor, cross, lower=True)
            factor, _ = jittered_cholesky(_covariance(theta, x, x) - whitened.T @ whitened)
            normal = rng.standard_normal((count, len(x)))
            samples.append(cross.T @ process.alpha + normal @ factor.T)
        means: Array = self._standardization.shift + self._standardization.scale * np.vstack(
            samples
        )
        return means

    def _sample(self, phi: Array, rng: np.random.Generator) -> list[_Conditioned]:
        process = self._condition(phi)
        kept = []
        for sweep in range(BURN_IN + KEPT):
            for coordinate in rng.permutation(len(phi)):
                process = self._move(process, int(coordinate), rng)
            if sweep >= BURN_IN:
                kept.append(process)
        return kept

    def _move(
        self, process: _Conditioned, coordinate: int, rng: np.random.Generator
    ) -> _Conditioned:
        """Draw one hyperparameter from its slice: step out, then shrink (Neal 2003, Sec. 4)."""
        level = process.value + np.log(rng.random())
        here = process.phi[coordinate]

        def at(place: float) -> _Conditioned:
            phi = process.phi.copy()
            phi[coordinate] = place
            return self._condition(phi)

        low = here - WIDTH * rng.random()
        high = low + WIDTH
        while at(low).value > level:
            low -= WIDTH
        while at(high).value > level:
            high += WIDTH
        while (moved := at(place := rng.uniform(low, high))).value <= level:
            low, high = (place, high) if place < here else (low, place)
        return moved

    def _condition(self, phi: Array) -> _Conditioned:
        lower, upper = self._box
        if ((phi < lower) | (phi > upper)).any():
            return _Conditioned(phi, -np.inf, np.empty((0, 0)), np.empty(0))
        data, theta = self._data, Hyperparameters.from_log(phi)
        covariance = _covariance(theta, data.x, data.x)
        covariance[np.diag_indices(len(data.x))] += theta.noise**2 * self._ratio / data.count
        factor, _ = jittered_cholesky(covariance)
        alpha, _ = lapack.dpotrs(factor, data.mean, lower=1)
        # Up to a constant; the last two terms are those of the observations about their means.
        likelihood = (
            -0.5 * data.mean @ alpha
            - np.log(np.diag(factor)).sum()
            - 0.5 * self._sum_of_squares / theta.noise**2
            - (data.observations - len(data.x)) * np.log(theta.noise)
        )
        return _Conditioned(phi, float(likelihood + PRIORS.log_density(phi)[0]), factor, alpha)


def _covariance(theta: Hyperparameters, a: Array, b: Array) -> Array:
    """Return the prior covariance of the contexts a (m, e) and b (n, e), shape (m, n).

    It is that of `bo_tuner.models.kernel` with the Matérn kernel (Rasmussen and Williams 2006,
    Eq. 4.17) for the squared exponential.
    """
    distance = np.sqrt(3.0 * scaled_squared_distances(a, b, theta.length_scales))
    covariance: Array = theta.signal**2 * (1.0 + distance) * np.exp(-distance) + MEAN_SD**2
    return covariance
