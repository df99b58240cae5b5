"""Gaussian process over parameter set and context, with noise that differs from place to place.

One process has all evaluations of all trials as its data, repeated ones pooled, so what is learnt
in one context or at one parameter set informs the others (Krause and Ong 2011). The kernel is the
squared exponential of `bo_tuner.models.kernel`, a product of one over the parameter set and one
over the context. Predictions of a parameter set in many contexts are therefore matrix products, and
the process of the mean over contexts has a closed form (O'Hagan 1991). As each trial is evaluated
several times, sums over the data are first taken over the evaluations of each parameter set, and
what depends on the parameter set alone is computed once for all of them.

The hyperparameters are those of a process with equal noise everywhere. Its squared residuals, each
divided by its expectation, are averaged with a kernel around a place (Fan and Yao 1998); the ratio
is that of the local noise variance to the common one, and the process is conditioned once more with
the local variances (one step of Kersting and others 2007).

Of a censored observation a lower bound is known (`bo_tuner.models.censoring`). It informs the
posterior; hyperparameters and noise are those of the others.

The mean over values of the last context columns, which nobody knows ahead, is a process of the same
form: as the kernel is a product, its factor of these columns is replaced by the mean of it.

Notation: d tuned parameters, e context variables; n distinct joint points z = (x, c) with r_i
observations each, of p distinct parameter sets; b points of the basis, of q distinct parameter
sets; m parameter sets and k contexts in a query.

References
----------
Fan and Yao (1998). Efficient estimation of conditional variance functions in stochastic regression.
Biometrika 85(3).
Kersting, Plagemann, Pfaff and Burgard (2007). Most likely heteroscedastic Gaussian process
regression. ICML.
Krause and Ong (2011). Contextual Gaussian process bandit optimization. NeurIPS 24.
O'Hagan (1991). Bayes-Hermite quadrature. Journal of Statistical Planning and Inference 29(3).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding
from bo_tuner.models.censoring import Censored, normal_factors
from bo_tuner.models.conditioning import Posterior, Prior, choose_basis
from bo_tuner.models.context_reduction import ContextReduction
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors
from bo_tuner.models.kernel import MEAN_SD, correlation
from bo_tuner.models.noise_shape import NoiseShape
from bo_tuner.models.parameter_sets import ParameterSets
from bo_tuner.models.replicates import Replicates, Standardization
from bo_tuner.numerics.arrays import Array

T = TypeVar("T")

WIDTH = 0.2
"""Width of the kernel around a place where noise is estimated, in edges of the unit cube.

Along the tuned parameters it grows with √d, as typical distances do.
"""

RESTARTED = 300
"""Most observations with which a fit also starts anew, not only at the last hyperparameters.

The last ones can be a local optimum of less data, which takes for noise what a context variable
does. With more observations that has come out, and a fit takes long.
"""

FITTED = 500
"""Largest number of observations that the hyperparameters are fitted to.

The time of a likelihood grows with the cube of that number, and with more of them it hardly
changes.
"""

LEAST_VARIANCE = 1e-10
"""Least posterior variance at a censored observation, in standardized units: rounding is less."""

BLOCK = 1000
"""Number of points at which noise is estimated at a time."""

PRIOR_DEGREES = 2.0
"""Weight of the common noise variance in a local one, in degrees of freedom."""


class _Latest(Generic[T]):
    """What was computed from the latest array, for mean and variance there need the same kernel.

    Arrays are compared by content, since a caller may change one in place. The pair is assigned at
    once, since threads may share a process.
    """

    def __init__(self) -> None:
        self._known: tuple[Array, T] | None = None

    def of(self, x: Array, compute: Callable[[Array], T]) -> T:
        """Return `compute(x)`, of which the caller must not change an array."""
        known = self._known
        if known is None or not np.array_equal(known[0], x):
            self._known = known = x.copy(), compute(x)
        return known[1]


class _Known:
    """What a process has computed from the latest parameter sets and contexts."""

    def __init__(self) -> None:
        self.kernel = _Latest[Array]()
        self.near = _Latest[Array]()
        self.reduction = _Latest[ContextReduction]()
        self.between = _Latest[Array]()
        self.noise = _Latest[tuple[Array, Array]]()


@dataclass(frozen=True, eq=False)
class PooledProcess:
    """Posterior of a response over parameter set and context; build it by `fit` or `condition`.

    Attributes
    ----------
    hyperparameters : Hyperparameters
        In scaled units; `noise` is the common one.
    standardization : Standardization
        Map between responses and standardized responses.
    data : Replicates
        Standardized observations at encoded joint points.
    apart : ndarray, shape (N,)
        Each standardized observation less the mean of those at its point.
    coding : Coding
        Of the parameters' columns.
    columns : int
        Number of the parameters' columns after the coding.
    squares, degrees : ndarray, shape (n,)
        Sum of squares of each point's observations, in common noise variances, and its degrees of
        freedom.
    posterior : Posterior
        Of the standardized response, with the local noise; its points are those of the data, and
        then those of censored observations.
    width : float
        Of the kernel around a place where noise is estimated, see `PooledProcesses`.
    warnings : tuple of str
        Numerical problems, one line each.
    over : ndarray, shape (r, w), or None
        Values of the last w context columns that it is the mean over, see `averaged`; the e context
        variables of a query are then those before.
    """

    hyperparameters: Hyperparameters
    standardization: Standardization
    data: Replicates
    apart: Array
    coding: Coding
    columns: int
    squares: Array
    degrees: Array
    posterior: Posterior
    width: float
    warnings: tuple[str, ...] = ()
    over: Array | None = None

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
        keep: bool = False,
        censored: Censored | None = None,
        errors: Array | None = None,
        width: float = WIDTH,
        restarted: int = RESTARTED,
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
        rng, priors, start, keep
            As `GaussianProcess.fit`.
        minimum_length_scales : ndarray, shape (d,), optional
            Lower bounds of the parameters' length scales.
        censored
            Further observations.
        errors : ndarray, shape (N,), optional
            Known standard errors of the responses, NaN where there is none. They stand in the
            posterior in place of the noise; noise elsewhere is that of the other responses.
        width, restarted
            Of the kernel around a place, and most observations with which a fit starts anew; see
            `WIDTH` and `RESTARTED`.
        """
        if keep and start is not None:
            return cls.condition(
                start, x, c, y, coding=coding, censored=censored, errors=errors, width=width
            )
        minimum = None
        if minimum_length_scales is not None:
            minimum = np.append(coding.spread(minimum_length_scales), np.zeros(c.shape[1]))
        z = np.hstack([coding.encode(x), c])
        chosen = _spread_over_values(y)
        process = GaussianProcess.fit(
            z[chosen],
            y[chosen],
            rng=rng,
            priors=priors,
            minimum_length_scales=minimum,
            start=start,
            restart=len(y) <= restarted,
        )
        return cls._conditioned(
            process.hyperparameters,
            process.standardization,
            z,
            y,
            coding,
            c,
            width,
            censored,
            errors,
            process.warnings,
        )

    @classmethod
    def condition(
        cls,
        hyperparameters: Sequence[float],
        x: Array,
        c: Array,
        y: Array,
        *,
        coding: Coding,
        censored: Censored | None = None,
        errors: Array | None = None,
        width: float = WIDTH,
    ) -> Self:
        """Condition on data with given hyperparameters, a `warm_start` of an earlier fit."""
        return cls._conditioned(
            Hyperparameters.from_log(np.array(hyperparameters)),
            Standardization.of(y),
            np.hstack([coding.encode(x), c]),
            y,
            coding,
            c,
            width,
            censored,
            errors,
        )

    @classmethod
    def _conditioned(
        cls,
        hyperparameters: Hyperparameters,
        standardization: Standardization,
        z: Array,
        y: Array,
        coding: Coding,
        c: Array,
        width: float,
        censored: Censored | None = None,
        errors: Array | None = None,
        warnings: tuple[str, ...] = (),
    ) -> Self:
        standardized = standardization.apply(y)
        data = Replicates.group(z, standardized)
        columns, common = z.shape[1] - c.shape[1], hyperparameters.noise**2
        error = common / data.count
        basis = choose_basis(hyperparameters, data.x, error)
        prior = Prior(hyperparameters, data.x, basis)
        equal = prior.condition(data.mean, error)
        apart = standardized - data.mean[data.index]
        within = np.bincount(data.index, apart**2, minlength=len(data.x))
        # A mean of r observations has the variance σ²/r, and its residual that times 1 - h.
        degrees = data.count - equal.leverages
        squares = equal.residuals**2 / error + within / common
        known = None if errors is None else (errors / standardization.scale) ** 2
        if known is not None:
            # A known error says nothing of the noise of others.
            unknown = np.bincount(data.index, np.isfinite(known), len(data.x)) == 0.0
            degrees, squares = degrees * unknown, squares * unknown
        local = _local_ratio(data.x, data.x, columns, squares, degrees, width)
        error = error * local
        if known is not None:
            each = np.where(np.isfinite(known), known, (common * local)[data.index])
            # Of observations at a point the more exact one counts more.
            precision = np.bincount(data.index, 1.0 / each, len(data.x))
            mean = np.bincount(data.index, standardized / each, len(data.x)) / precision
            data, error = replace(data, mean=mean), 1.0 / precision
            apart = standardized - mean[data.index]
        if censored is None or not len(censored):
            posterior = prior.condition(data.mean, error)
        else:
            places = np.hstack([coding.encode(censored.x), censored.c])
            noise = common * _local_ratio(places, data.x, columns, squares, degrees, width)
            bounds = standardization.apply(censored.bounds)
            posterior = _with_censored(hyperparameters, data, error, places, bounds, noise)
        return cls(
            hyperparameters,
            standardization,
            data,
            apart,
            coding,
            columns,
            squares,
            degrees,
            posterior,
            width,
            (*warnings, *posterior.warnings),
        )

    def averaged(self, rows: Array) -> Self:
        """Return the process of the mean over rows (r, w) of the last w context columns."""
        return replace(self, over=rows)

    @property
    def scale(self) -> float:
        """Standard deviation of the responses."""
        return self.standardization.scale

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest mean of the responses at a point."""
        least, largest = self.data.mean.min(), self.data.mean.max()
        shift, scale = self.standardization.shift, self.standardization.scale
        return float(shift + scale * least), float(shift + scale * largest)

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
        """Distinct parameter sets (p, d) of the data, in the unit cube."""
        return self.coding.decode(self._data_sets.distinct)

    @property
    def counts(self) -> Array:
        """Number of observations (p,) of each of `points`."""
        return self._data_sets.sum(self.data.count)

    def means(self, x: Array, contexts: Array) -> Array:
        """Return the posterior mean (m, k) of the parameter sets x (m, d) in contexts (k, e)."""
        constant = MEAN_SD**2 * self.posterior.weights.sum()
        mean = self._parameter_kernel(x) @ self._reduction(contexts).weights + constant
        means: Array = self.standardization.shift + self.scale * mean
        return means

    def variances(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> Array:
        """Return the posterior variance (m,) of x (m, d), each in the context of its own row.

        Parameters
        ----------
        x : ndarray, shape (m, d)
        contexts : ndarray, shape (k, e)
        which : ndarray of int, shape (m,)
            Row of `contexts` for each parameter set.
        """
        reduction = self._reduction(contexts).of_each(self._parameter_kernel(x), which)
        return self._variance(self._prior_variance, reduction)

    def variance_of_mean(self, x: Array, contexts: Array) -> Array:
        """Return the posterior variance (m,) of the mean over contexts (k, e), at x (m, d)."""
        reduction = self._reduction(contexts).of_mean(self._parameter_kernel(x))
        prior = self.hyperparameters.signal**2 * self._between(contexts).mean()
        return self._variance(float(prior) + MEAN_SD**2, reduction)

    def variance_of_weighted(
        self, x: Array, contexts: Array, weights: Array, total: float = 1.0
    ) -> Array:
        """Return the posterior variance (m,) of sums over contexts (k, e) with weights (m, k).

        The weights of each parameter set add up to `total`: 1 of a mean, 0 of a difference.
        """
        reduction = self._reduction(contexts).of_sums(self._parameter_kernel(x), weights, total)
        within = weights @ self._between(contexts)
        prior = self.hyperparameters.signal**2 * np.einsum("ij,ij->i", within, weights)
        return self._variance(prior + (total * MEAN_SD) ** 2, reduction)

    def noise(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the local noise variance (m,), in the squared unit, and its degrees of freedom.

        Parameters
        ----------
        x : ndarray, shape (m, d)
        contexts : ndarray, shape (k, e)
        which : ndarray of int, shape (m,)
            Row of `contexts` for each parameter set.
        """
        near, (squares, degrees) = self._near(x), self._noise_across(contexts)
        variance, total = self._noise(
            np.einsum("ij,ij->i", near, squares.T[which]),
            np.einsum("ij,ij->i", near, degrees.T[which]),
        )
        if self.over is None:
            return variance, total
        return variance + self._spread(x, contexts)[np.arange(len(x)), which], total

    def noise_everywhere(self, x: Array, contexts: Array) -> tuple[Array, Array]:
        """Return noise variance and degrees of freedom (m, k) of x (m, d) in contexts (k, e)."""
        near, (squares, degrees) = self._near(x), self._noise_across(contexts)
        variance, total = self._noise(near @ squares, near @ degrees)
        if self.over is None:
            return variance, total
        return variance + self._spread(x, contexts), total

    def noise_deviations(self, z: float, sign: float) -> float:
        """Return `NoiseShape.deviations` by the residuals of all observations."""
        return self._shape.deviations(z, sign)

    @cached_property
    def _shape(self) -> NoiseShape:
        # Each of r observations at a point has the variance σ² (1 - h / r) about the posterior
        # mean, with h the leverage of their mean.
        own, index, whole = self.posterior, self.data.index, len(self.data.x)
        left = np.clip(1.0 - own.leverages[:whole] / self.data.count, 0.0, 1.0)[index]
        deviation = np.sqrt(own.variances[:whole] * self.data.count)[index]
        residuals = (self.apart + own.residuals[index]) / deviation
        least = np.finfo(np.float64).eps
        return NoiseShape.of(residuals / np.sqrt(np.maximum(left, least)), left)

    def _noise(self, squares: Array, degrees: Array) -> tuple[Array, Array]:
        each = self._shape.degrees
        total = each * degrees + PRIOR_DEGREES
        return self.noise_variance * (each * squares + PRIOR_DEGREES) / total, total

    def _spread(self, x: Array, contexts: Array) -> Array:
        """Return the variance (m, k) of the mean response over the rows of `over`."""
        rows = np.empty((0, 0)) if self.over is None else self.over
        joint = [np.repeat(contexts, len(rows), axis=0), np.tile(rows, (len(contexts), 1))]
        means = self._of_rows.means(x, np.hstack(joint))
        spread: Array = means.reshape(len(x), len(contexts), len(rows)).var(axis=2)
        return spread

    @cached_property
    def _of_rows(self) -> Self:
        """The process that it is the mean of."""
        return replace(self, over=None)

    def _variance(self, prior: float | Array, reduction: Array) -> Array:
        variance: Array = self.scale**2 * np.maximum(prior - reduction, 0.0)
        return variance

    @property
    def _prior_variance(self) -> float:
        return self.hyperparameters.signal**2 * self._between_rows + MEAN_SD**2

    @cached_property
    def _between_rows(self) -> float:
        """Mean of k(r, r') of all pairs of rows of `over`; 1 without it."""
        if self.over is None:
            return 1.0
        scales = self._context_scales[-self.over.shape[1] :]
        return float(correlation(self.over, self.over, scales).mean())

    @cached_property
    def _basis_sets(self) -> ParameterSets:
        return ParameterSets(self.posterior.basis, self.columns)

    @cached_property
    def _data_sets(self) -> ParameterSets:
        return ParameterSets(self.data.x, self.columns)

    @cached_property
    def _known(self) -> _Known:
        return _Known()

    def _parameter_kernel(self, x: Array) -> Array:
        """Return s² k(x, u) of x (m, d) with the parameter sets u of the basis, shape (m, q)."""

        def compute(x: Array) -> Array:
            scales = self.hyperparameters.length_scales[: self.columns]
            near = correlation(self.coding.encode(x), self._basis_sets.distinct, scales)
            return self.hyperparameters.signal**2 * near

        return self._known.kernel.of(x, compute)

    def _reduction(self, contexts: Array) -> ContextReduction:
        """Return what predictions in contexts (k, e) need."""

        def compute(contexts: Array) -> ContextReduction:
            basis = self.posterior.basis[:, self.columns :]
            across = self._across(basis, contexts, self._context_scales)
            return ContextReduction(self.posterior, self._basis_sets, across, self._prior_variance)

        return self._known.reduction.of(contexts, compute)

    def _between(self, contexts: Array) -> Array:
        """Return k(c, c) of all pairs of contexts (k, e), shape (k, k)."""

        def compute(contexts: Array) -> Array:
            scales = self._context_scales[: contexts.shape[1]]
            return correlation(contexts, contexts, scales) * self._between_rows

        return self._known.between.of(contexts, compute)

    def _across(self, own: Array, contexts: Array, scales: Array) -> Array:
        """Return k of own (n, e + w) with contexts (k, e), shape (n, k), as the mean over `over`.

        Parameters
        ----------
        own, contexts
            Without `over`, both have all columns.
        scales : ndarray, shape (e + w,)
            Of the columns.
        """
        if self.over is None:
            return correlation(own, contexts, scales)
        e = contexts.shape[1]
        measured = correlation(own[:, e:], self.over, scales[e:]).mean(axis=1)
        averaged: Array = correlation(own[:, :e], contexts, scales[:e]) * measured[:, None]
        return averaged

    def _near(self, x: Array) -> Array:
        """Return the weight in the noise at x (m, d) of the sets of the data, shape (m, p)."""

        def compute(x: Array) -> Array:
            distinct = self._data_sets.distinct
            widths = _parameter_widths(self.columns, self.width)
            return correlation(self.coding.encode(x), distinct, widths)

        return self._known.near.of(x, compute)

    def _noise_across(self, contexts: Array) -> tuple[Array, Array]:
        """Return the squares and degrees of the data's sets, weighted for contexts, (p, k) each."""

        def compute(contexts: Array) -> tuple[Array, Array]:
            own = self.data.x[:, self.columns :]
            across = self._across(own, contexts, np.full(own.shape[1], self.width))
            sums = self._data_sets.sum
            return sums(across * self.squares[:, None]), sums(across * self.degrees[:, None])

        return self._known.noise.of(contexts, compute)

    @property
    def _context_scales(self) -> Array:
        return self.hyperparameters.length_scales[self.columns :]


@dataclass(frozen=True)
class PooledProcesses:
    """Makes `PooledProcess`es.

    Attributes
    ----------
    width
        Of the kernel around a place where noise is estimated, in edges of the unit cube; see
        `WIDTH`. With a large one the noise is the same everywhere.
    restarted
        Most observations with which a fit starts anew, too; see `RESTARTED`.
    """

    width: float = WIDTH
    restarted: int = RESTARTED

    def fit(
        self,
        x: Array,
        c: Array,
        y: Array,
        *,
        coding: Coding,
        rng: np.random.Generator,
        priors: Hyperpriors | None = None,
        minimum_length_scales: Array | None = None,
        start: Sequence[float] | None = None,
        keep: bool = False,
        censored: Censored | None = None,
        errors: Array | None = None,
    ) -> PooledProcess:
        """Fit a process, see `PooledProcess.fit`."""
        return PooledProcess.fit(
            x,
            c,
            y,
            coding=coding,
            rng=rng,
            priors=priors,
            minimum_length_scales=minimum_length_scales,
            start=start,
            keep=keep,
            censored=censored,
            errors=errors,
            width=self.width,
            restarted=self.restarted,
        )

    def condition(
        self,
        hyperparameters: Sequence[float],
        x: Array,
        c: Array,
        y: Array,
        *,
        coding: Coding,
        censored: Censored | None = None,
    ) -> PooledProcess:
        """Condition a process on data, see `PooledProcess.condition`."""
        return PooledProcess.condition(
            hyperparameters, x, c, y, coding=coding, censored=censored, width=self.width
        )


def _with_censored(
    hyperparameters: Hyperparameters,
    data: Replicates,
    error: Array,
    places: Array,
    bounds: Array,
    noise: Array,
) -> Posterior:
    """Return the posterior by data with the errors (n,) and by censored observations.

    Parameters
    ----------
    hyperparameters, data, error
        Of the data.
    places : ndarray, shape (k, d + e)
        Where the others are.
    bounds, noise : ndarray, shape (k,)
        Their lower bounds and noise variances, in standardized units.
    """
    points, whole = np.vstack([data.x, places]), len(data.x)
    errors = np.concatenate([error, noise])
    prior = Prior(hyperparameters, points, choose_basis(hyperparameters, points, errors))

    def conditioned(means: Array, variances: Array) -> Posterior:
        return prior.condition(
            np.concatenate([data.mean, means]), np.concatenate([error, variances])
        )

    def marginals(means: Array, variances: Array) -> tuple[Array, Array]:
        posterior = conditioned(means, variances)
        variance = variances * posterior.leverages[whole:]
        return means - posterior.residuals[whole:], np.maximum(variance, LEAST_VARIANCE)

    return conditioned(*normal_factors(marginals, bounds, noise))


def _local_ratio(
    z: Array, points: Array, columns: int, squares: Array, degrees: Array, width: float
) -> Array:
    """Return the local over the common noise variance at joint points, (m,)."""
    contexts = points.shape[1] - columns
    widths = np.append(_parameter_widths(columns, width), np.full(contexts, width))
    weighted = np.column_stack([squares, degrees])
    # In blocks: the kernel between all data would take more memory than anything else.
    blocks = np.array_split(z, 1 + len(z) // BLOCK)
    near = np.vstack([correlation(block, points, widths) @ weighted for block in blocks])
    ratio: Array = (near[:, 0] + PRIOR_DEGREES) / (near[:, 1] + PRIOR_DEGREES)
    return ratio


def _parameter_widths(columns: int, width: float) -> Array:
    """Return the widths (columns,) of the kernel around a place, `width` along a context."""
    return np.full(columns, width * columns**0.5)


def _spread_over_values(y: Array) -> NDArray[np.intp]:
    """Return `FITTED` of the observations y (N,) with the distribution of all, or all of them."""
    if len(y) <= FITTED:
        return np.arange(len(y))
    ranks = np.linspace(0, len(y) - 1, FITTED).round().astype(np.intp)
    return np.sort(np.argsort(y, kind="stable")[ranks])
