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
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from bo_tuner.models.categories import Coding
from bo_tuner.models.conditioning import Posterior, Prior, choose_basis
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors
from bo_tuner.models.kernel import MEAN_SD, correlation
from bo_tuner.models.replicates import Replicates, Standardisation
from bo_tuner.numerics.arrays import Array

T = TypeVar("T")

WIDTH = 0.2
"""Width of the kernel around a place whose noise is estimated, in edges of the unit cube.

Along the tuned parameters it grows with √d, as typical distances do.
"""

RESTARTED = 300
"""Most observations with which a fit starts anew, too, and not at the last hyperparameters alone.

The last ones can be a local optimum, found with less data, that takes for noise what a context
variable does. With more observations that has been found out, and a fit takes long.
"""

FITTED = 500
"""Largest number of observations that the hyperparameters are fitted to.

The time of a likelihood grows with the cube of that number, and with more of them it hardly
changes.
"""

BLOCK = 1000
"""Number of points whose noise is estimated at a time."""

WORTH_A_FACTOR = 300
"""Number of variances in a context from which on its own factor is worth its time."""

NOISY = 1e-7
"""Least noise variance of a mean, in prior variances, with which factors are used.

With prior variance s² and noise variance λ their error is about ε s³ / √λ, ε = 2e-16, which at the
data, where the variance is λ, is a part ε (s² / λ)^1.5 of it. The direct way has more digits.
"""

PRIOR_DEGREES = 2.0
"""Weight of the common noise variance in a local one, in degrees of freedom."""


class _Latest(Generic[T]):
    """What was computed of the latest array, for mean and variance there need the same kernel.

    Arrays are compared by content, since a caller may change one in place. The pair is assigned at
    once, since threads may share a process.
    """

    def __init__(self, compute: Callable[[Array], T]) -> None:
        self._compute = compute
        self._known: tuple[Array, T] | None = None

    def of(self, x: Array) -> T:
        """Return `compute(x)`, which the caller must not change."""
        known = self._known
        if known is None or not np.array_equal(known[0], x):
            self._known = known = x.copy(), self._compute(x)
        return known[1]


class _Sets:
    """Distinct parameter sets of sorted joint points (n, columns + e), which sort them, too."""

    def __init__(self, z: Array, columns: int) -> None:
        x = z[:, :columns]
        begins = np.ones(len(z), dtype=bool)
        begins[1:] = (x[1:] != x[:-1]).any(axis=1)
        self._starts = np.flatnonzero(begins)
        self._owners = np.cumsum(begins) - 1
        self.distinct = x[self._starts]

    def sum(self, values: Array, axis: int = 0) -> Array:
        """Return the sums of values (…, n, …) over the points of each parameter set."""
        found: Array = np.add.reduceat(values, self._starts, axis=axis)
        return found

    def spread(self, values: Array) -> Array:
        """Return values (m, q) of parameter sets at their points, shape (m, n)."""
        spread: Array = values[:, self._owners]
        return spread


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
    posterior : Posterior
        Of the standardized response, with the local noise.
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
    posterior: Posterior
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
        keep: bool = False,
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
        """
        if keep and start is not None:
            return cls.condition(start, x, c, y, coding=coding)
        minimum = None
        if minimum_length_scales is not None:
            minimum = np.append(coding.spread(minimum_length_scales), np.zeros(c.shape[1]))
        z = np.hstack([coding.encode(x), c])
        some = _spread_over_values(y)
        process = GaussianProcess.fit(
            z[some],
            y[some],
            rng=rng,
            priors=priors,
            minimum_length_scales=minimum,
            start=start,
            restart=len(y) <= RESTARTED,
        )
        return cls._conditioned(
            process.hyperparameters, process.standardisation, z, y, coding, c, process.warnings
        )

    @classmethod
    def condition(
        cls, hyperparameters: Sequence[float], x: Array, c: Array, y: Array, *, coding: Coding
    ) -> Self:
        """Condition on data with given hyperparameters, a `warm_start` of an earlier fit."""
        return cls._conditioned(
            Hyperparameters.from_log(np.array(hyperparameters)),
            Standardisation.of(y),
            np.hstack([coding.encode(x), c]),
            y,
            coding,
            c,
        )

    @classmethod
    def _conditioned(
        cls,
        hyperparameters: Hyperparameters,
        standardisation: Standardisation,
        z: Array,
        y: Array,
        coding: Coding,
        c: Array,
        warnings: tuple[str, ...] = (),
    ) -> Self:
        standardised = standardisation.apply(y)
        data = Replicates.group(z, standardised)
        columns, common = z.shape[1] - c.shape[1], hyperparameters.noise**2
        error = common / data.count
        basis = choose_basis(hyperparameters, data.x, error)
        prior = Prior(hyperparameters, data.x, basis)
        equal = prior.condition(data.mean, error)
        within = np.bincount(
            data.index, (standardised - data.mean[data.index]) ** 2, minlength=len(data.x)
        )
        # A mean of r observations has the variance σ²/r, and its residual that times 1 - h.
        degrees = data.count - equal.leverages
        squares = equal.residuals**2 / error + within / common
        local = _local_ratio(data.x, data.x, columns, squares, degrees)[0]
        posterior = prior.condition(data.mean, error * local)
        return cls(
            hyperparameters,
            standardisation,
            data,
            coding,
            columns,
            squares,
            degrees,
            posterior,
            (*warnings, *posterior.warnings),
        )

    @property
    def scale(self) -> float:
        """Standard deviation of the responses."""
        return self.standardisation.scale

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest mean of the responses at a point."""
        least, largest = self.data.mean.min(), self.data.mean.max()
        shift, scale = self.standardisation.shift, self.standardisation.scale
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
        weights = self.posterior.weights
        mean = self._parameter_kernel.of(x) @ self._across.of(contexts).weighted
        found: Array = self.standardisation.shift + self.scale * (mean + MEAN_SD**2 * weights.sum())
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
        kernel, across = self._parameter_kernel.of(x), self._across.of(contexts)
        across.asked += np.bincount(which, minlength=len(contexts))
        prior = self.hyperparameters.signal**2 + MEAN_SD**2
        direct = ~across.worth_a_factor[which]
        reduction = np.empty(len(x))
        for row in np.unique(which[~direct]):
            here = which == row
            reduction[here] = self._factored(kernel[here], across.factor(row))
        cross = self._basis_sets.spread(kernel[direct]) * across.kernel.T[which[direct]]
        reduction[direct] = self._reduction(cross + MEAN_SD**2)
        return self._variance(prior, reduction)

    def variance_of_mean(self, x: Array, contexts: Array) -> Array:
        """Return the posterior variance (m,) of the mean over contexts (k, e), at x (m, d)."""
        kernel, across = self._parameter_kernel.of(x), self._across.of(contexts)
        if across.exact:
            reduction = self._factored(kernel, across.factor_of_mean)
        else:
            cross = self._basis_sets.spread(kernel) * across.kernel.mean(axis=1)
            reduction = self._reduction(cross + MEAN_SD**2)
        prior = self.hyperparameters.signal**2 * self._between.of(contexts).mean()
        return self._variance(float(prior) + MEAN_SD**2, reduction)

    def variance_of_weighted(self, x: Array, contexts: Array, weights: Array) -> Array:
        """Return the posterior variance (m,) of sums over contexts (k, e) with weights (m, k)."""
        across = weights @ self._across.of(contexts).kernel.T
        cross = self._basis_sets.spread(self._parameter_kernel.of(x)) * across
        within = weights @ self._between.of(contexts)
        prior = self.hyperparameters.signal**2 * np.einsum("ij,ij->i", within, weights)
        return self._variance(prior + MEAN_SD**2, self._reduction(cross + MEAN_SD**2))

    def noise(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the local noise variance (m,), in the squared unit, and its degrees of freedom.

        Parameters
        ----------
        x, contexts, which
            As in `variances`.
        """
        variance, degrees = self.noise_everywhere(x, contexts)
        rows = np.arange(len(x))
        return variance[rows, which], degrees[rows, which]

    def noise_everywhere(self, x: Array, contexts: Array) -> tuple[Array, Array]:
        """Return as `noise`, for each of x (m, d) in all contexts (k, e); (m, k) each."""
        near, (squares, degrees) = self._near.of(x), self._noise_across.of(contexts)
        total = near @ degrees + PRIOR_DEGREES
        return self.noise_variance * (near @ squares + PRIOR_DEGREES) / total, total

    @cached_property
    def _basis_sets(self) -> _Sets:
        return _Sets(self.posterior.basis, self.columns)

    @cached_property
    def _data_sets(self) -> _Sets:
        return _Sets(self.data.x, self.columns)

    @cached_property
    def _parameter_kernel(self) -> _Latest[Array]:
        """s² k(x, u) of x (m, d) with the parameter sets u of the basis, shape (m, q)."""
        scales = self.hyperparameters.length_scales[: self.columns]
        return _Latest(
            lambda x: (
                self.hyperparameters.signal**2
                * correlation(self.coding.encode(x), self._basis_sets.distinct, scales)
            )
        )

    @cached_property
    def _across(self) -> "_Latest[_Across]":
        return _Latest(lambda contexts: _Across(self, contexts))

    @cached_property
    def _between(self) -> _Latest[Array]:
        """k(c, c) of all pairs of contexts (k, e), shape (k, k)."""
        return _Latest(lambda c: correlation(c, c, self._context_scales))

    @cached_property
    def _near(self) -> _Latest[Array]:
        """Weight in the noise at x (m, d) of the parameter sets of the data, shape (m, p)."""
        widths = _widths(self.columns, self.data.x[:, self.columns :])[: self.columns]
        sets = self._data_sets.distinct
        return _Latest(lambda x: correlation(self.coding.encode(x), sets, widths))

    @cached_property
    def _noise_across(self) -> _Latest[tuple[Array, Array]]:
        """Sums of squares and degrees of freedom of the sets, weighted for contexts (p, k)."""
        own = self.data.x[:, self.columns :]
        widths = _widths(self.columns, own)[self.columns :]

        def compute(contexts: Array) -> tuple[Array, Array]:
            across = correlation(own, contexts, widths)
            sums = self._data_sets.sum
            return sums(across * self.squares[:, None]), sums(across * self.degrees[:, None])

        return _Latest(compute)

    @property
    def _context_scales(self) -> Array:
        return self.hyperparameters.length_scales[self.columns :]

    def _reduction(self, cross: Array) -> Array:
        """Return ‖W k‖² (m,) of covariances k with the basis, the rows of cross (m, b)."""
        whitened = blas.dtrmm(1.0, self.posterior.whitening, cross.T, lower=1)
        reduction: Array = np.einsum("ij,ij->j", whitened, whitened)
        return reduction

    def _factored(self, kernel: Array, factor: Array) -> Array:
        """Return ‖W k‖² (m,) by a factor of `_Across`, of s² k(x, u) (m, q)."""
        extended = np.vstack([kernel.T, np.ones(len(kernel))])
        reduced = blas.dtrmm(1.0, factor, extended)
        reduction: Array = np.einsum("ij,ij->j", reduced, reduced)
        return reduction

    def _variance(self, prior: float | Array, reduction: Array) -> Array:
        found: Array = self.scale**2 * np.maximum(prior - reduction, 0.0)
        return found


class _Across:
    """What predictions in given contexts need, whatever the parameter set.

    Parameters
    ----------
    process
        Of the response.
    contexts : ndarray, shape (k, e)

    Attributes
    ----------
    kernel : ndarray, shape (b, k)
        k(c_u, c) with the contexts of the basis.
    weighted : ndarray, shape (q, k)
        The mean at x is s² k(x, u) @ weighted, less that of the constant.
    asked : ndarray of int, shape (k,)
        Number of variances that each context was asked for.
    """

    def __init__(self, process: JointProcess, contexts: Array) -> None:
        self._process = process
        basis = process.posterior.basis[:, process.columns :]
        self.kernel = correlation(basis, contexts, process._context_scales)
        self.weighted = process._basis_sets.sum(self.kernel * process.posterior.weights[:, None])
        self.asked = np.zeros(len(contexts), dtype=np.intp)
        self._factors: dict[int, Array] = {}

    @property
    def worth_a_factor(self) -> NDArray[np.bool_]:
        """Which contexts (k,) are asked for so many variances that a factor saves time."""
        few_sets = 2 * len(self._process._basis_sets.distinct) <= len(self.kernel)
        worth: NDArray[np.bool_] = (self.asked > WORTH_A_FACTOR) & (few_sets and self.exact)
        return worth

    @property
    def exact(self) -> bool:
        """Whether there is so much noise that variances by a factor are exact."""
        theta, count = self._process.hyperparameters, self._process.data.count
        return bool(theta.noise**2 / count.max() >= NOISY * (theta.signal**2 + MEAN_SD**2))

    def factor(self, row: int) -> Array:
        """Return the factor (q + 1, q + 1) of a context, see `_factor`."""
        if row not in self._factors:
            self._factors[row] = self._factor(self.kernel[:, row])
        return self._factors[row]

    @cached_property
    def factor_of_mean(self) -> Array:
        """The factor (q + 1, q + 1) of the mean over the contexts, see `_factor`."""
        return self._factor(self.kernel.mean(axis=1))

    def _factor(self, across: Array) -> Array:
        """Return the upper triangular R with ‖R g‖² = ‖W k‖², where g is s² k(x, u) and a 1.

        The covariance of a sum over contexts at x with the basis is k_i = s² k(x, u_i) a_i +
        MEAN_SD², with the sum a (b,) of k(c_u, c). Points of one parameter set have the same u_i,
        so W k is the product of g with a matrix that has a column for each parameter set; R is that
        of its QR factorization. (The square of the matrix would be faster, and lose half of the
        digits of small variances.)
        """
        whitening, sets = self._process.posterior.whitening, self._process._basis_sets
        columns = sets.sum(whitening * across, axis=1)
        constant = MEAN_SD**2 * whitening.sum(axis=1)
        factored, _, _, _ = lapack.dgeqrf(np.column_stack([columns, constant]))
        rows = np.zeros((factored.shape[1], factored.shape[1]), order="F")
        rows[: len(factored)] = np.triu(factored[: factored.shape[1]])
        return rows


def _local_ratio(
    z: Array, points: Array, columns: int, squares: Array, degrees: Array
) -> tuple[Array, Array]:
    """Return local over common noise variance and degrees of freedom at joint points, (m,) each."""
    widths = _widths(columns, points[:, columns:])
    weighted = np.column_stack([squares, degrees])
    # In blocks, lest the kernel between all data takes more memory than anything else.
    blocks = np.array_split(z, 1 + len(z) // BLOCK)
    near = np.vstack([correlation(block, points, widths) @ weighted for block in blocks])
    return (near[:, 0] + PRIOR_DEGREES) / (near[:, 1] + PRIOR_DEGREES), near[:, 1] + PRIOR_DEGREES


def _widths(columns: int, contexts: Array) -> Array:
    """Return the widths of the kernel around a place whose noise is estimated, see `WIDTH`."""
    return np.append(np.full(columns, WIDTH * columns**0.5), np.full(contexts.shape[1], WIDTH))


def _spread_over_values(y: Array) -> NDArray[np.intp]:
    """Return `FITTED` of the observations y (N,) with the distribution of all, or all of them."""
    if len(y) <= FITTED:
        return np.arange(len(y))
    ranks = np.linspace(0, len(y) - 1, FITTED).round().astype(np.intp)
    return np.sort(np.argsort(y, kind="stable")[ranks])
