"""Stage two: the worst context of one parameter set (Sec. 4.2), by ask and tell."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperpriors, LogNormal
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximise
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import WorstCase

OBSERVED, POSTERIOR = "observed", "posterior"

SEARCH_EFFORT = SwarmSettings(particles=40, iterations=25, stall=6)

MOST_CORNER_DIMENSIONS = 5
"""The swarm starts in all corners of so many leading dimensions: worst cases like corners."""

DISTINCT = 0.1
"""Contexts closer than this in the unit cube count as one."""

# A handful of evaluations cannot tell noise from a short length scale. The priors say what holds
# for a plant in a bounded box: the response is smooth across it, and a context matters more than
# noise.
PRIORS = Hyperpriors(
    length_scale=LogNormal(0.7, 0.5, 0.1, 20.0),
    signal=LogNormal(1.0, 0.5, 0.05, 20.0),
    noise=LogNormal(0.15, 0.5, 1e-3, 3.0),
)


class WorstCaseSearch:
    """Bayesian search of the context that maximises one metric of a parameter set.

    It builds on whatever contexts it is told, tries given starting contexts, then maximises the
    reinterpolation expected improvement. It ends when the limit is violated or all evaluations are
    used.

    Parameters
    ----------
    space
        The contexts.
    limit
        Upper limit of the metric.
    evaluations
        Most contexts that `ask` will give.
    estimate
        ``observed``, as in the paper: the limit is violated by a single observation above it, and
        the worst case is the largest observation, which noise biases upwards by more, the more
        evaluations there are. ``posterior``: violated where the posterior mean is a standard
        deviation above it, and the worst case is the largest posterior mean over all contexts.
    starts
        Contexts that were the worst for neighbouring parameter sets; tried first in any case.
    """

    def __init__(
        self,
        space: ContextSpace,
        limit: float,
        evaluations: int,
        estimate: str = POSTERIOR,
        starts: Sequence[Mapping[str, float]] = (),
    ) -> None:
        self._space = space
        self._limit = limit
        self._evaluations = evaluations if space.dimension > 0 else 0
        self._estimate = estimate
        self._starts = [dict(start) for start in starts[: self._evaluations]]
        self._contexts: list[Array] = []
        self._values: list[float] = []
        self._asked = 0

    def tell(self, context: Mapping[str, float], value: float) -> None:
        """Take note of an evaluation: its context and the metric."""
        self._contexts.append(np.array([context[name] for name in self._space.names]))
        self._values.append(value)

    def done(self, rng: np.random.Generator) -> bool:
        """Whether nothing is left to ask: all evaluations are used, or the limit is violated."""
        if self._asked >= self._evaluations:
            return True
        if self._starts:
            return False
        if max(self._values) <= self._limit or self._estimate == OBSERVED:
            return max(self._values) > self._limit
        model = self._fit(rng)
        mean, variance = model.predict(model.data.x)
        return bool((mean - np.sqrt(variance)).max() > self._limit)

    def ask(self, rng: np.random.Generator) -> dict[str, float]:
        """Give the next context.

        Where the model leaves no improvement to expect, it is the context that is farthest from
        all that were tried.
        """
        self._asked += 1
        if self._starts:
            return self._starts.pop(0)
        model = self._fit(rng)
        lowest = -float(model.predict(model.data.x)[0].max())

        def acquisition(x: Array) -> Array:
            mean, variance = model.predict_reinterpolated(x)
            return log_expected_improvement(-mean, variance, lowest)

        def distance(x: Array) -> Array:
            squared = ((x[:, None, :] - model.data.x[None, :, :]) ** 2).sum(axis=2)
            nearest: Array = squared.min(axis=1)
            return nearest

        context, value = self._maximise(acquisition, rng)
        if not np.isfinite(value):
            context, _ = self._maximise(distance, rng)
        return context

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all that was told."""
        top = int(np.argmax(self._values))
        observed = self._values[top]
        if self._estimate == OBSERVED or self._space.dimension == 0:
            return WorstCase(observed, self._space.to_dict(self._contexts[top]), observed)
        model = self._fit(rng)
        context, value = self._maximise(model.predict_mean, rng)
        return WorstCase(value, context, observed, model.noise_variance**0.5)

    def _fit(self, rng: np.random.Generator) -> GaussianProcess:
        x = self._space.to_cube(np.array(self._contexts))
        return GaussianProcess.fit(x, np.array(self._values), rng=rng, priors=PRIORS)

    def _maximise(
        self, function: Callable[[Array], Array], rng: np.random.Generator
    ) -> tuple[dict[str, float], float]:
        tried = self._space.to_cube(np.array(self._contexts))
        return maximise_over_contexts(self._space, function, rng, tried)


def maximise_over_contexts(
    space: ContextSpace,
    function: Callable[[Array], Array],
    rng: np.random.Generator,
    initial: Array,
) -> tuple[dict[str, float], float]:
    """Maximise a function of the context by a small swarm.

    Parameters
    ----------
    space
        The contexts.
    function
        Maps contexts (m, e) of the unit cube to values (m,).
    rng
        Moves the swarm.
    initial
        Contexts (k, e) of the unit cube to start from, besides the corners.

    Returns
    -------
    context
        The best one.
    value
        The function there.
    """
    found = maximise(
        function,
        space.dimension,
        rng,
        repair=lambda x: space.to_cube(space.to_contexts(x)),
        initial=np.vstack([initial, corners(space)]),
        settings=SEARCH_EFFORT,
    )
    return space.to_dict(space.to_contexts(found.position[None])[0]), found.value


def corners(space: ContextSpace) -> Array:
    """Corners (m, e) of the unit cube; beyond `MOST_CORNER_DIMENSIONS`, of the leading ones."""
    axes = [[0.0, 1.0]] * min(space.dimension, MOST_CORNER_DIMENSIONS)
    points = np.full((2 ** len(axes), space.dimension), 0.5)
    points[:, : len(axes)] = np.array(np.meshgrid(*axes)).reshape(len(axes), -1).T
    return points


def worst_contexts_nearby(
    point: Array,
    tried: Array,
    worst_cases: Sequence[WorstCase],
    space: ContextSpace,
    count: int,
) -> list[dict[str, float]]:
    """Worst contexts of the nearest parameter sets, all different.

    Parameters
    ----------
    point
        Parameter set (d,) in the unit cube.
    tried
        Parameter sets (n, d) with a known worst case.
    worst_cases
        These worst cases, n of them.
    space
        The contexts.
    count
        Most contexts to return; half as many neighbours again are asked for them.
    """
    if space.dimension == 0:
        return []
    chosen: list[Mapping[str, float]] = []
    nearest = np.argsort(((tried - point) ** 2).sum(axis=1), kind="stable")
    for index in nearest[: count + (count + 1) // 2]:
        candidate = worst_cases[int(index)].context
        if all(_distance(candidate, other, space) > DISTINCT for other in chosen):
            chosen.append(candidate)
    return [dict(context) for context in chosen[:count]]


def _distance(a: Mapping[str, float], b: Mapping[str, float], space: ContextSpace) -> float:
    rows = space.to_cube([[c[name] for name in space.names] for c in (a, b)])
    return float(np.abs(rows[0] - rows[1]).max())
