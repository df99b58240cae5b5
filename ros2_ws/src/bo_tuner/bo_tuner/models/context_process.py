"""Interface of the processes over parameter set and context.

Notation: d tuned parameters, e context variables, all in unit cubes; N observations; m parameter
sets and k contexts in a query.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding
from bo_tuner.models.censoring import Censored
from bo_tuner.models.hyperpriors import Hyperpriors
from bo_tuner.models.protocol import Fitted
from bo_tuner.numerics.arrays import Array


class ContextProcess(Fitted, Protocol):
    """Posterior of a response over parameter set and context, with local noise.

    Attributes
    ----------
    points : ndarray, shape (p, d)
        Distinct parameter sets of the data.
    counts : ndarray, shape (p,)
        Number of observations of each of them.
    scale : float
        Spread of the responses, in their unit.
    range : tuple of float
        Least and largest mean of the responses at a joint point.
    noise_variance : float
        Common variance of one observation's noise, in the squared unit of the response.
    """

    @property
    def points(self) -> Array: ...  # noqa: D102

    @property
    def counts(self) -> Array: ...  # noqa: D102

    @property
    def scale(self) -> float: ...  # noqa: D102

    @property
    def range(self) -> tuple[float, float]: ...  # noqa: D102

    @property
    def noise_variance(self) -> float: ...  # noqa: D102

    def means(self, x: Array, contexts: Array) -> Array:
        """Return the mean (m, k) of the parameter sets x (m, d) in contexts (k, e)."""

    def variances(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> Array:
        """Return the variance (m,) of x (m, d), each in the context of its own row `which` (m,)."""

    def variance_of_mean(self, x: Array, contexts: Array) -> Array:
        """Return the variance (m,) of the mean over contexts (k, e), at x (m, d)."""

    def variance_of_weighted(
        self, x: Array, contexts: Array, weights: Array, total: float = 1.0
    ) -> Array:
        """Return the variance (m,) of sums over contexts (k, e) with weights (m, k).

        The weights of each parameter set add up to `total`: 1 of a mean, 0 of a difference.
        """

    def noise(self, x: Array, contexts: Array, which: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return noise variance and degrees of freedom (m,), each of x in the context `which`."""

    def noise_everywhere(self, x: Array, contexts: Array) -> tuple[Array, Array]:
        """Return noise variance and degrees of freedom (m, k) of x (m, d) in contexts (k, e)."""

    def noise_deviations(self, z: float, sign: float) -> float:
        """Return the local standard deviations within which noise stays with probability Φ(z).

        Upwards with the `sign` 1, downwards with -1; z itself for normal noise.
        """

    def averaged(self, rows: Array) -> "ContextProcess":
        """Return the process of the mean over the last columns of the context.

        Its contexts are without these columns, and its noise is that of a run with any of the rows.

        Parameters
        ----------
        rows : ndarray, shape (r, w)
            Values of the last w columns, which are equally probable.
        """


class ContextProcesses(Protocol):
    """A kind of such processes, which makes them of observations."""

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
    ) -> ContextProcess:
        """Fit to responses y (N,) of the parameter sets x (N, d) in contexts c (N, e).

        Parameters
        ----------
        x, c, y
            The observations; e may be 0.
        coding
            Of the parameters' columns.
        rng
            Source of random numbers.
        priors
            Of hyperparameters, if the process has any.
        minimum_length_scales : ndarray, shape (d,), optional
            Lower bounds of the parameters' length scales.
        start
            `warm_start` of an earlier fit.
        keep
            Whether `start` is good enough as it is, since little is new since that fit.
        censored
            Further observations, of which lower bounds are known.
        errors : ndarray, shape (N,), optional
            Known standard errors of the responses, NaN where there is none.
        """

    def condition(
        self,
        hyperparameters: Sequence[float],
        x: Array,
        c: Array,
        y: Array,
        *,
        coding: Coding,
        censored: Censored | None = None,
    ) -> ContextProcess:
        """Condition on observations with the `warm_start` of an earlier fit."""
