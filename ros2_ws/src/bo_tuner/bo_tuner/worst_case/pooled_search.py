"""Stage two with one process over parameter set and context, with local noise."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding
from bo_tuner.models.censoring import Censored
from bo_tuner.models.context_maximum import maximize_over_contexts
from bo_tuner.models.context_process import ContextProcess
from bo_tuner.models.covariates import Covariates
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.pooled_responses import EveryContext
from bo_tuner.models.simulation import moved
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context, WorstCase
from bo_tuner.worst_case.contexts import PRIORS, is_clear


@dataclass(frozen=True, eq=False)
class KnownRuns:
    """Earlier evaluations of a study.

    Attributes
    ----------
    x, c : ndarray, shapes (n, d) and (n, e)
        Parameter sets and contexts in their unit cubes.
    y : ndarray, shape (n,)
        Values of the metric.
    coding
        Of the parameters' columns.
    measured
        By name of a measured context its values (n,).
    censored
        Further ones, of which lower bounds are known.
    simulated
        Which (n,) are of a simulation; None without one.
    """

    x: Array
    c: Array
    y: Array
    coding: Coding
    measured: Mapping[str, Array] = field(default_factory=dict)
    censored: Censored | None = None
    simulated: NDArray[np.bool_] | None = None


class PooledSearch:
    """Search for the worst context of one parameter set, with an ask-and-tell interface.

    Each evaluation is where the constrained quantity, the mean or the quantile of a run, has the
    largest upper confidence bound, by a process to which all earlier evaluations contribute.

    Parameters
    ----------
    space
        The context space.
    point
        The parameter set (d,) in the unit cube.
    known
        Evaluations of other parameter sets. Values of measured contexts come with the context of
        further ones; the worst case is that of the mean over them.
    limit
        Upper limit of the metric, in its unit.
    deviations
        Standard deviations of a single run between its mean and the limit; 0 for a limit on the
        mean.
    evaluations
        Largest number of contexts that `ask` returns.
    models
        Say which kind of process, and on which scale.
    hyperparameters
        `warm_start` of an earlier fit of the process; by default they are fitted to the data.
    until_clear
        Whether the search ends when the decision is clear.
    """

    def __init__(
        self,
        space: ContextSpace,
        point: Array,
        known: KnownRuns,
        *,
        limit: float,
        deviations: float,
        evaluations: int,
        models: PooledModels,
        hyperparameters: Sequence[float] | None = None,
        until_clear: bool,
    ) -> None:
        self._space = space
        self._limit = limit
        self._deviations = deviations
        self._evaluations = evaluations
        self._point = point
        self._processes = models.processes
        self._scale = models.scale(known.y, limit, 1.0)
        self._x, self._c, self._y = known.x, known.c, self._scale.apply(known.y)
        self._coding = known.coding
        self._censored = known.censored
        self._hyperparameters = hyperparameters
        self._until_clear = until_clear
        self._measured = dict(known.measured)
        self._simulated = known.simulated
        self._process: ContextProcess | None = None
        self._observed: list[float] = []
        self._asked = 0

    def tell(self, context: Context, value: float) -> None:
        """Add an evaluation: its context and the constrained metric."""
        self._x = np.vstack([self._x, self._point])
        self._c = np.vstack([self._c, self._space.cube_of([context])])
        for name, values in self._measured.items():
            self._measured[name] = np.append(values, float(context[name]))
        if self._simulated is not None:
            self._simulated = np.append(self._simulated, False)
        self._scale = self._scale.including(value)
        self._y = np.append(self._y, self._scale.apply(value))
        self._observed.append(value)
        self._process = None

    def done(self, rng: np.random.Generator) -> bool:
        """Return whether all evaluations are used or the decision is clear."""
        if self._asked >= self._evaluations:
            return True
        if not self._until_clear:
            return False
        process = self._fit(rng)
        context, _ = self._maximize(self._upper(process), rng)
        mean, variance = self._quantile(process, self._space.cube_of([context]))
        return is_clear(self._limit - float(mean[0]), float(variance[0]), self._asked)

    def ask(self, rng: np.random.Generator) -> Context:
        """Return the context with the largest upper confidence bound."""
        self._asked += 1
        return self._maximize(self._upper(self._fit(rng)), rng)[0]

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all evaluations so far, with the local noise there."""
        process = self._fit(rng)
        point = self._point[None]
        context, _ = self._maximize(lambda c: self._everywhere(process, c).limited(point)[0], rng)
        in_context = self._everywhere(process, self._space.cube_of([context]))
        _, mean, noise = in_context.worst_case(point)
        return WorstCase(float(mean[0]), context, max(self._observed), float(noise[0]))

    def _fit(self, rng: np.random.Generator) -> ContextProcess:
        if self._process is None:
            self._process = self._fitted(rng)
        return self._process

    def _fitted(self, rng: np.random.Generator) -> ContextProcess:
        seen = np.column_stack([np.empty((len(self._c), 0)), *self._measured.values()])
        covariates = Covariates(seen, self._simulated)
        if not covariates.width:
            return self._fitted_to(self._c, rng)
        c = np.hstack([self._c, covariates.own])
        return self._fitted_to(c, rng).averaged(covariates.to_average)

    def _fitted_to(self, c: Array, rng: np.random.Generator) -> ContextProcess:
        y = self._y
        if self._simulated is not None:
            y, _ = moved(self._x, y, self._simulated)
        data, coding, censored = (self._x, c, y), self._coding, None
        if self._censored is not None:
            censored = self._censored.on_scale(self._scale.apply)
        if self._hyperparameters is None:
            return self._processes.fit(
                *data, coding=coding, rng=rng, priors=PRIORS, censored=censored
            )
        return self._processes.condition(
            self._hyperparameters, *data, coding=coding, censored=censored
        )

    def _quantile(self, process: ContextProcess, c: Array) -> tuple[Array, Array]:
        points = np.tile(self._point, (len(c), 1))
        return self._everywhere(process, c).predict_in(points, np.arange(len(c)))

    def _everywhere(self, process: ContextProcess, c: Array) -> EveryContext:
        return EveryContext(process, self._limit, c, self._deviations, scale=self._scale)

    def _upper(self, process: ContextProcess) -> Callable[[Array], Array]:
        def upper(c: Array) -> Array:
            mean, variance = self._quantile(process, c)
            return mean + np.sqrt(variance)

        return upper

    def _maximize(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[Context, float]:
        own = self._c[len(self._c) - len(self._observed) :]
        if self._space.dimension == 0:
            return {}, float(function(np.empty((1, 0)))[0])
        return maximize_over_contexts(self._space, function, rng, own)
