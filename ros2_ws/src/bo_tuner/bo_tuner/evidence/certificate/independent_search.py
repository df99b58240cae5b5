"""A search for the worst context that is independent of stage two.

Stage two spends ten evaluations on a parameter set and starts in contexts that were the worst for
others. A maximum that it missed is also missed by a check in the worst context that it found. Here
the evaluations go to every corner of the box, to a space-filling design, and then to where a model
of all these evaluations does not exclude the largest value: the local maxima of its upper bound,
from many starts, and the next largest of it elsewhere. Local maxima alone are often one, again and
again the same, and a model that is too smooth never looks beside it.

`most_searched` bounds their number. The search ends before where the limit is clearly violated
in some context, or clearly kept in all; the verdict rests on the repetitions in the contexts that
it returns in any case. Every combination of discrete values is among these, in the context of its
largest prediction: no model tells that a value is harmless in which nothing was run. So where all
contexts are discrete there is nothing to search. Neither does a model of the mean tell where noise
or rare runs are the worst: a box of few corners has all of them among the candidates.
"""

from collections.abc import Callable, Generator, Sequence

import numpy as np
from scipy.optimize import minimize

from bo_tuner.models.categories import Coding
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context, Value

Values = Sequence[float | None]
"""A metric in some contexts, None where the evaluation failed."""

Search = Generator[list[Context], Values, list[Context]]
"""Yields batches of contexts, is sent the values of a metric in them, and returns contexts."""

SPREAD_EVALUATIONS = 12
"""Evaluations of the space-filling design, a Latin hypercube."""

ROUNDS, EVALUATIONS_A_ROUND = 4, 5
"""Rounds of local searches, and the largest number of contexts evaluated after each."""

UPPER = 2.0
"""Standard deviations from the mean to the upper bound of which the maxima are searched."""

STARTS = 10
"""Local searches per round, from the contexts with the largest predictions."""

OTHERS = 200
"""Contexts considered as starts besides the evaluated ones and the corners."""

CANDIDATES = 5
"""Number of candidates for the worst context, without those that are there in any case."""

FEW_CORNERS = 4
"""Number of corners up to which all of them are candidates."""

CARRIED = 3
"""Further candidates by all runs, those of earlier certificates as well."""

DISTINCT = 0.1
"""Starts and maxima closer than this in the unit cube count as one."""

APART = 0.02
"""Candidates closer than this in the unit cube count as one. A maximum near a corner, and the
corner, are two: the model is too smooth to tell which is worse."""

CLEAR = 3.0
"""Standard deviations between the mean and the limit that end a search.

A violation ends it by the error of the mean in a context that was evaluated; a kept limit by that
of a single run all over the box, which leaves room for what a model overlooks.
"""

MOST_MODELLED = 150
"""Further drawn contexts are left out of the model, whose cost grows with the cube of their
number."""


def most_searched(space: ContextSpace, known: int) -> int:
    """Return the largest number of evaluations of `find_worst_contexts` with `known` contexts."""
    if space.is_discrete:
        return 0
    return len(space.corners()) + SPREAD_EVALUATIONS + known + ROUNDS * EVALUATIONS_A_ROUND


def least_searched(space: ContextSpace, known: int) -> int:
    """Return the number of evaluations of `find_worst_contexts` where a limit is clearly kept."""
    if space.is_discrete:
        return 0
    return len(space.corners()) + SPREAD_EVALUATIONS + known + EVALUATIONS_A_ROUND


def most_candidates(space: ContextSpace) -> int:
    """Return the largest number of candidates for the worst context of one limit."""
    if space.is_discrete:
        return space.count_combinations
    return CANDIDATES + len(_in_any_case(space))


def least_candidates(space: ContextSpace) -> int:
    """Return the smallest number of candidates, where the search is about few contexts."""
    if space.is_discrete:
        return space.count_combinations
    return max(CANDIDATES, len(_in_any_case(space)))


def find_worst_contexts(
    space: ContextSpace,
    drawn: Sequence[tuple[Context, float]],
    known: Sequence[Context],
    limit: float,
    rng: np.random.Generator,
) -> Search:
    """Find contexts in which a metric may be the largest."""
    if space.is_discrete:
        return _every_context(space, drawn, known)
    tried = _Tried(space, drawn[:MOST_MODELLED])
    spread = latin_hypercube(SPREAD_EVALUATIONS, space.dimension, rng)
    known_points = space.cube_of(known)
    yield from tried.evaluate(np.vstack([known_points, space.corners()]))
    model = tried.fit(rng)
    if model is None or not _is_violated(model, limit):
        yield from tried.evaluate(spread)
    for done in range(ROUNDS):
        model = tried.fit(rng)
        if model is None or _is_violated(model, limit):
            break
        # A model with few data is too sure of itself until its maxima were looked at.
        if done > 0 and _is_kept(space, model, limit, rng):
            break
        upper = _upper(model)
        maxima = _local_maxima(space, model, upper, rng)
        others = space.to_cube(space.to_contexts(_all_over(space, model, rng)))
        others = others[np.argsort(-upper(others), kind="stable")]
        yield from tried.evaluate(_distinct([*maxima, *others])[:EVALUATIONS_A_ROUND])
    model = tried.fit(rng)
    for context, value in drawn[MOST_MODELLED:]:
        tried.add(space.cube_of([context])[0], value)
    return [space.to_dict(row) for row in tried.candidates(known_points, model, rng)]


def worst_of_all(
    space: ContextSpace,
    contexts: Sequence[Context],
    values: Sequence[float],
    candidates: Sequence[Context],
    rng: np.random.Generator,
) -> list[Context]:
    """Return the contexts with the largest posterior means, of all in which there was a run."""
    if space.dimension == 0:
        return []
    points = space.cube_of(contexts)
    nothing = np.empty((len(points), 0))
    model = PooledProcess.fit(nothing, points, np.array(values), coding=Coding(()), rng=rng)
    places, which = np.unique(points, axis=0, return_index=True)
    means = model.means(np.empty((1, 0)), places)[0]
    known = list(space.cube_of(candidates))
    largest: list[Context] = []
    for index in np.argsort(-means, kind="stable"):
        if len(largest) < CARRIED and _is_distinct(places[index], known):
            known.append(places[index])
            # The very same context, and not its way to the cube and back.
            largest.append(dict(contexts[which[index]]))
    return largest


class _Tried:
    """Evaluated contexts, as points of the unit cube, with the metric."""

    def __init__(self, space: ContextSpace, drawn: Sequence[tuple[Context, float]]) -> None:
        self._space = space
        self._points = list(space.cube_of([context for context, _ in drawn]))
        self._values = [value for _, value in drawn]

    def add(self, point: Array, value: float) -> None:
        self._points.append(point)
        self._values.append(value)

    def evaluate(self, points: Array) -> Generator[list[Context], Values, None]:
        """Ask for the metric at points (n, e)."""
        contexts = [self._space.to_contexts(point[None]) for point in points]
        values = yield [self._space.to_dict(context[0]) for context in contexts]
        for context, value in zip(contexts, values, strict=True):
            if value is not None:
                self.add(self._space.to_cube(context)[0], value)

    def fit(self, rng: np.random.Generator) -> GaussianProcess | None:
        if not self._values:
            return None
        return GaussianProcess.fit(np.array(self._points), np.array(self._values), rng=rng)

    def candidates(
        self, known: Array, model: GaussianProcess | None, rng: np.random.Generator
    ) -> Array:
        """Contexts (m, e) to look at closely, in own units."""
        edge = self._space.corners()
        if model is None:
            # Every evaluation failed, so nothing prefers one context to another.
            return self._space.to_contexts(_distinct([*known, *edge])[:CANDIDATES])
        points = np.array(self._points)
        maxima = _local_maxima(self._space, model, model.predict_mean, rng)
        corner = edge[int(np.argmax(model.predict_mean(edge)))]
        seen = points[int(np.argmax(self._values))]
        # A maximum this close to the corner is taken for it.
        highest = corner if np.abs(maxima[0] - corner).max() <= APART else maxima[0]
        first = _distinct([highest, corner, seen, *known], APART)
        others = points[np.argsort(-model.predict_mean(points), kind="stable")]
        rest = _distinct([*first, *maxima, *others])
        # `rest` starts with `first`, except for those that are close to each other.
        rest = rest[[not (first == point).all(axis=1).any() for point in rest]]
        chosen = first[:CANDIDATES]
        for group in _in_any_case(self._space):
            if not self._has(chosen, group):
                places = self._like(group, points)
                best = places[int(np.argmax(model.predict_mean(places)))]
                chosen = np.vstack([chosen, best])
        free = max(0, CANDIDATES - len(chosen))
        return self._space.to_contexts(np.vstack([chosen, rest[:free]]))

    def _has(self, chosen: Array, group: Array) -> bool:
        """Return whether the combination of a group, or its only corner, is among the chosen."""
        if len(group) == 1 and self._space.count_combinations == 1:
            return not _is_distinct(group[0], list(chosen), APART)
        own = self._space.combination_of(group[:1])[0]
        return own in self._space.combination_of(chosen)

    def _like(self, group: Array, points: Array) -> Array:
        """Return a group with the evaluated points of the same combination."""
        if self._space.count_combinations == 1:
            return group
        own = self._space.combination_of(group[:1])[0]
        same = [combination == own for combination in self._space.combination_of(points)]
        return np.vstack([group, points[same]])


def _in_any_case(space: ContextSpace) -> list[Array]:
    """Return groups of points of the cube of each of which one is a candidate in any case.

    They are the corners in each combination of discrete values or, without discrete variables, each
    corner by itself if they are few.
    """
    groups = list(space.combinations())
    if len(groups) > 1:
        return groups
    corners = groups[0]
    return [corner[None] for corner in corners] if len(corners) <= FEW_CORNERS else []


def _every_context(
    space: ContextSpace, drawn: Sequence[tuple[Context, float]], known: Sequence[Context]
) -> list[Context]:
    """Return all contexts of a discrete space: the known ones, then by their largest drawn value.

    It is only an order: each of them takes its runs.
    """
    every = [space.to_dict(space.to_contexts(group)[0]) for group in space.combinations()]
    largest: dict[tuple[Value, ...], float] = {}
    for context, value in drawn:
        key = tuple(context.values())
        largest[key] = max(value, largest.get(key, -np.inf))
    keys = [tuple(context.values()) for context in every]
    first = [tuple(context.values()) for context in known]
    order = sorted(
        range(len(every)),
        key=lambda k: (keys[k] not in first, -largest.get(keys[k], -np.inf)),
    )
    return [every[k] for k in order]


def _is_violated(model: GaussianProcess, limit: float) -> bool:
    """Return whether the mean clearly exceeds the limit in a context of the data."""
    mean, variance = model.predict(model.points)
    return bool((mean - CLEAR * np.sqrt(variance) > limit).any())


def _is_kept(
    space: ContextSpace, model: GaussianProcess, limit: float, rng: np.random.Generator
) -> bool:
    """Return whether single runs clearly keep the limit all over the box."""
    mean, variance = model.predict(_all_over(space, model, rng))
    upper = mean + CLEAR * np.sqrt(variance + model.noise_variance)
    return bool((upper <= limit).all())


def _all_over(space: ContextSpace, model: GaussianProcess, rng: np.random.Generator) -> Array:
    """Return the points of the data, the corners and a space-filling design, (m, e)."""
    return np.vstack([model.points, space.corners(), latin_hypercube(OTHERS, space.dimension, rng)])


def _upper(model: GaussianProcess) -> Callable[[Array], Array]:
    def upper(x: Array) -> Array:
        mean, variance = model.predict(x)
        return mean + UPPER * np.sqrt(variance)

    return upper


def _local_maxima(
    space: ContextSpace,
    model: GaussianProcess,
    function: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Array:
    """Distinct local maxima (m, e) of a function on the unit cube, the largest first."""
    starts = _all_over(space, model, rng)
    best = starts[np.argsort(-function(starts), kind="stable")]
    ends = [
        minimize(
            lambda x: -float(function(x[None])[0]),
            start,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * space.dimension,
        ).x
        for start in _distinct(best)[:STARTS]
    ]
    # Moves a discrete variable to its nearest possible value.
    maxima = space.to_cube(space.to_contexts(np.clip(np.array(ends), 0.0, 1.0)))
    return _distinct(maxima[np.argsort(-function(maxima), kind="stable")])


def _distinct(points: Sequence[Array] | Array, distance: float = DISTINCT) -> Array:
    """Return the points (n, e) that are farther than a distance from all points kept before."""
    kept: list[Array] = []
    for point in points:
        if _is_distinct(point, kept, distance):
            kept.append(point)
    return np.array(kept)


def _is_distinct(point: Array, others: Sequence[Array], distance: float = DISTINCT) -> bool:
    return all(np.abs(point - other).max() > distance for other in others)
