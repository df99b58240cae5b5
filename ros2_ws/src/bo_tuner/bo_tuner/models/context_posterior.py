"""Where in the context space a machine is, by its runs and a simulator.

The simulator is run at parameter sets that the machine was run with, over a design of contexts. Of
each metric j at each parameter set g a Gaussian process over the context c has the mean f_gj(c)
and the variance v_gj(c) of what is not known of it; Σ_g is the covariance of a run's noise between
the metrics, by the residuals. The mean ȳ_g of the n_g runs of the machine then has the likelihood

    N(ȳ_g; f_g(c), Σ_g / n_g + diag v_g(c)),

a synthetic likelihood (Wood 2010) by an emulator of the simulator, as in the calibration of
computer models (Kennedy and O'Hagan 2001). Their discrepancy between simulator and machine is left
out on purpose: with it, any data fit somewhere. It is tested instead: a posterior predictive
p-value (Gelman, Meng and Stern 1996) is the probability, over the posterior, that runs of the
simulator would be as far from its means as those of the machine are.

References
----------
Kennedy and O'Hagan (2001). Bayesian calibration of computer models. Journal of the Royal
Statistical Society B 63(3).
Wood (2010). Statistical inference for noisy nonlinear ecological dynamic systems. Nature 466.
Gelman, Meng and Stern (1996). Posterior predictive assessment of model fitness via realized
discrepancies. Statistica Sinica 6(4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import chdtrc, erfc, fdtrc

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.tempering import sample_posterior
from bo_tuner.study.context_space import ContextSpace

LEAST_SIMULATED = 10
"""Runs of the simulator at a parameter set that a Gaussian process takes at least."""
MOST_LEVERAGE = 0.9
"""Share of its own noise that a run has in the mean there, at most."""


@dataclass(frozen=True, eq=False)
class Emulator:
    """What the simulator gives at one parameter set; build it by `fit`.

    In the shapes, k is the number of metrics, d the number of columns of the contexts' unit cube.

    Attributes
    ----------
    processes : tuple of GaussianProcess
        Of each metric over the context.
    noise : ndarray, shape (k, k)
        Σ_g, the covariance of the metrics of one run.
    freedom : float
        Degrees of freedom of its estimate.
    """

    processes: tuple[GaussianProcess, ...]
    noise: Array
    freedom: float

    @classmethod
    def fit(
        cls, cube: Array, values: Array, rng: np.random.Generator, latest: int | None = None
    ) -> Self:
        """Fit a process to each metric.

        Parameters
        ----------
        cube : ndarray, shape (N, d)
            Contexts of the runs.
        values : ndarray, shape (N, k)
            Their metrics.
        rng
            Draws starting points of the fits.
        latest
            The noise is that of so many runs, the last ones; None for all. It may differ over the
            contexts, and counts where the machine may be.
        """
        processes = tuple(GaussianProcess.fit(cube, column, rng=rng) for column in values.T)
        last = slice(None if latest is None else -latest, None)
        mean, variance = _predict(processes, cube[last])
        assumed = np.array([process.noise_variance for process in processes])
        # A run pulls the mean to itself, by the share of its noise that the mean then still has.
        leverage = np.minimum(variance / np.maximum(assumed, np.finfo(float).tiny), MOST_LEVERAGE)
        residuals = (values[last] - mean) / np.sqrt(1.0 - leverage)
        count, metrics = residuals.shape
        covariance = residuals.T @ residuals / count
        # Correlations are shrunk as if as many runs without one had been made as there are metrics.
        noise: Array = covariance * (count / (count + metrics))
        np.fill_diagonal(noise, np.maximum(np.diag(covariance), np.finfo(float).tiny))
        return cls(processes, noise, float((1.0 - leverage).sum(axis=0).mean()))

    def predict(self, cube: Array) -> tuple[Array, Array]:
        """Return means f_g and variances v_g, both (m, k), at contexts (m, d)."""
        return _predict(self.processes, cube)


def _predict(processes: Sequence[GaussianProcess], cube: Array) -> tuple[Array, Array]:
    """Return means and variances (m, k) of k processes at contexts (m, d)."""
    pairs = [process.predict(cube) for process in processes]
    return np.stack([m for m, _ in pairs], axis=1), np.stack([v for _, v in pairs], axis=1)


@dataclass(frozen=True, eq=False)
class RealRuns:
    """What the machine gave at one parameter set.

    Attributes
    ----------
    values : ndarray, shape (n, k)
        The metrics of its n ≥ 1 runs.
    """

    values: Array

    @property
    def mean(self) -> Array:
        """Their mean ȳ_g, shape (k,)."""
        mean: Array = self.values.mean(axis=0)
        return mean

    @property
    def scatter(self) -> Array:
        """Sum of squares (k,) around the mean."""
        scatter: Array = ((self.values - self.mean) ** 2).sum(axis=0)
        return scatter


@dataclass(frozen=True)
class MisfitTest:
    """A comparison of the machine with the simulator in the contexts of the posterior.

    Attributes
    ----------
    metric
        Position of the metric; None for all metrics together.
    of_scatter
        Whether it compares how much equal runs differ, and not their means.
    p_value
        The posterior predictive p-value.
    deviations
        Of the mean of a metric: by how many standard deviations it is off, as the median over the
        posterior, positive if the machine's is larger; of a scatter the ratio of the machine's
        standard deviation to the simulator's; of all metrics together 0.
    """

    metric: int | None
    of_scatter: bool
    p_value: float
    deviations: float = 0.0


@dataclass(frozen=True, eq=False)
class ContextPosterior:
    """Samples of the contexts in which the machine may be, and how well they explain its runs.

    Attributes
    ----------
    contexts : ndarray, shape (m, v)
        In own units, equally weighted.
    tests : tuple of MisfitTest
        All that were made; each has the same share of the error probability.
    """

    contexts: Array
    tests: tuple[MisfitTest, ...]

    def misfits(self, level: float) -> list[MisfitTest]:
        """Return the tests that refute every context, at a level of all of them together."""
        return [test for test in self.tests if test.p_value < level / len(self.tests)]


def noise_of(machine: Sequence[RealRuns]) -> Array:
    """Return the covariance (k, k) of the noise of a machine's runs, pooled over parameter sets.

    For a simulator that has no noise.

    Raises
    ------
    ValueError
        If fewer runs were repeated than there are metrics, or two.
    """
    metrics = machine[0].values.shape[1]
    freedom = sum(len(runs.values) - 1 for runs in machine)
    if freedom < max(metrics, 2):
        raise ValueError(f"expected at least {max(metrics, 2)} repeated runs, found {freedom}")
    centred = np.vstack([runs.values - runs.mean for runs in machine])
    covariance: Array = centred.T @ centred / freedom
    # Shrunk as the correlation of the residuals of an emulator.
    shrunk: Array = covariance * (freedom / (freedom + metrics))
    np.fill_diagonal(shrunk, np.diag(covariance))
    return shrunk


def infer_context(
    space: ContextSpace,
    emulators: Sequence[Emulator],
    machine: Sequence[RealRuns],
    rng: np.random.Generator,
) -> ContextPosterior:
    """Return the posterior over the contexts of a space; its distribution is the prior.

    Parameters
    ----------
    space
        The contexts.
    emulators, machine
        Of each parameter set, in the same order.
    rng
        Draws the samples.
    """
    pairs = list(zip(emulators, machine, strict=True))

    def log_likelihood(quantiles: Array) -> Array:
        cube = space.to_cube(space.at_quantiles(quantiles))
        total = np.zeros(len(cube))
        for emulator, runs in pairs:
            residuals, covariance = _of_means(emulator, runs, cube)
            _, logarithm = np.linalg.slogdet(covariance)
            total -= 0.5 * (_squared(residuals, covariance) + logarithm)
        return total

    quantiles = sample_posterior(log_likelihood, len(space.names), rng)
    contexts = space.at_quantiles(quantiles)
    return ContextPosterior(contexts, _tests(pairs, space.to_cube(contexts)))


def _of_means(emulator: Emulator, runs: RealRuns, cube: Array) -> tuple[Array, Array]:
    """Return the residuals (m, k) of the machine's mean and their covariance (m, k, k)."""
    mean, variance = emulator.predict(cube)
    covariance = np.repeat(emulator.noise[None] / len(runs.values), len(cube), axis=0)
    places = np.arange(variance.shape[1])
    covariance[:, places, places] += variance
    return runs.mean - mean, covariance


def _squared(residuals: Array, covariance: Array) -> Array:
    """Return rᵀ S⁻¹ r (m,) of residuals (m, k) with covariances (m, k, k)."""
    solved = np.linalg.solve(covariance, residuals[..., None])[..., 0]
    squared: Array = (residuals * solved).sum(axis=1)
    return squared


def _tests(pairs: Sequence[tuple[Emulator, RealRuns]], cube: Array) -> tuple[MisfitTest, ...]:
    """Return the tests of all metrics together, of each mean, and of each scatter."""
    metrics = pairs[0][1].values.shape[1]
    joint = np.zeros(len(cube))
    weighted, precision = np.zeros((len(cube), metrics)), np.zeros((len(cube), metrics))
    scatter, freedom, of_simulator = np.zeros(metrics), 0, 0.0
    for emulator, runs in pairs:
        residuals, covariance = _of_means(emulator, runs, cube)
        joint += _squared(residuals, covariance)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        weighted += residuals / variance
        precision += 1.0 / variance
        scatter += runs.scatter / np.diag(emulator.noise)
        freedom += len(runs.values) - 1
        of_simulator += emulator.freedom
    tests = [MisfitTest(None, False, float(chdtrc(len(pairs) * metrics, joint).mean()))]
    z = weighted / np.sqrt(precision)
    for metric in range(metrics):
        p_value = float(erfc(np.abs(z[:, metric]) / np.sqrt(2.0)).mean())
        tests.append(MisfitTest(metric, False, p_value, float(np.median(z[:, metric]))))
    if freedom:
        for metric in range(metrics):
            ratio = float(scatter[metric] / freedom)
            p_value = float(fdtrc(freedom, of_simulator, ratio))
            tests.append(MisfitTest(metric, True, p_value, float(np.sqrt(ratio))))
    return tuple(tests)
