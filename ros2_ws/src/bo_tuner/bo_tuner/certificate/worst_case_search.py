"""A search of the worst context that is independent of stage two's.

Stage two spends ten evaluations on a parameter set and starts where its neighbours were the worst.
What it overlooked, a check in its own worst context overlooks as well. So nothing of it is used
here, neither priors nor swarm nor starting points, only the box and the class of models.
Evaluations go to every corner, all over the box, and then to the local maxima that a model of all
these evaluations has from many starts.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.study.context_space import ContextSpace

Context = dict[str, float]
Evaluate = Callable[[Mapping[str, float]], float | None]
"""Runs an evaluation in a context; returns the metric, or None if the evaluation failed."""

SPREAD_EVALUATIONS = 12
"""Evaluations all over the box, by a Latin hypercube."""

ROUNDS, EVALUATIONS_A_ROUND = 4, 5
"""Rounds of local searches, and the most maxima that are evaluated after each."""

STARTS = 10
"""Local searches of a round, from the tried and some other contexts where the most is expected."""

OTHERS = 200
"""Contexts that were not tried, among which starts are sought."""

CANDIDATES = 5
"""Contexts that may be the worst one."""

DISTINCT = 0.1
"""Starts and maxima closer than this in the unit cube count as one."""

APART = 0.02
"""Candidates closer than this in the unit cube are one; a maximum beside a corner and the corner
itself are two: the model is too smooth to tell which is worse."""

MOST_MODELLED = 150
"""Drawn contexts beyond this do not join the model, whose cost grows with their cube."""


def most_evaluations(space: ContextSpace, known: int) -> int:
    """Return how many evaluations `find_worst_contexts` asks for at most, with `known` contexts."""
    if space.dimension == 0:
        return 0
    return len(space.corners()) + SPREAD_EVALUATIONS + known + ROUNDS * EVALUATIONS_A_ROUND


def find_worst_contexts(
    space: ContextSpace,
    evaluate: Evaluate,
    drawn: Sequence[tuple[Mapping[str, float], float]],
    known: Sequence[Mapping[str, float]],
    rng: np.random.Generator,
) -> list[Context]:
    """Find contexts in which a metric may be the largest.

    Parameters
    ----------
    space
        The contexts.
    evaluate
        Called for each evaluation.
    drawn
        Contexts that were evaluated already, with the metric.
    known
        Contexts that somebody else takes for the worst.
    rng
        Source of the starts.

    Returns
    -------
    list of dict
        `CANDIDATES` contexts at most: where the model expects the most, of all and of the corners,
        where the most was seen, the known ones, and others for which the model expects much.
    """
    if space.dimension == 0:
        return [{}]
    tried = _Tried(space, drawn[:MOST_MODELLED])
    spread = latin_hypercube(SPREAD_EVALUATIONS, space.dimension, rng)
    known_points = _points(space, known)
    for point in np.vstack([space.corners(), spread, known_points]):
        tried.run(point, evaluate)
    for _ in range(ROUNDS):
        model = tried.fit(rng)
        if model is None:
            break
        for point in _local_maxima(space, model, _upper(model), rng)[:EVALUATIONS_A_ROUND]:
            tried.run(point, evaluate)
    model = tried.fit(rng)
    for context, value in drawn[MOST_MODELLED:]:
        tried.add(_points(space, [context])[0], value)
    return [space.to_dict(row) for row in tried.candidates(known_points, model, rng)]


class _Tried:
    """Contexts that were tried, as points of the unit cube, with the metric."""

    def __init__(
        self, space: ContextSpace, drawn: Sequence[tuple[Mapping[str, float], float]]
    ) -> None:
        self._space = space
        self._points = list(_points(space, [context for context, _ in drawn]))
        self._values = [value for _, value in drawn]

    def add(self, point: Array, value: float) -> None:
        self._points.append(point)
        self._values.append(value)

    def run(self, point: Array, evaluate: Evaluate) -> None:
        context = self._space.to_contexts(point[None])
        value = evaluate(self._space.to_dict(context[0]))
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
            # Every evaluation failed: the corners are as good as any.
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
        # Those of `first` that are close to each other are not all in `rest`.
        rest = rest[[not (first == point).all(axis=1).any() for point in rest]]
        return self._space.to_contexts(np.vstack([first, rest])[:CANDIDATES])


def _upper(model: GaussianProcess) -> Callable[[Array], Array]:
    def upper(x: Array) -> Array:
        mean, variance = model.predict(x)
        return mean + np.sqrt(variance)

    return upper


def _local_maxima(
    space: ContextSpace,
    model: GaussianProcess,
    function: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Array:
    """Local maxima (m, e) of a function of the unit cube, all different, the largest first."""
    starts = np.vstack(
        [model.data.x, space.corners(), latin_hypercube(OTHERS, space.dimension, rng)]
    )
    best = starts[np.argsort(-function(starts), kind="stable")]
    found = [
        minimize(
            lambda x: -float(function(x[None])[0]),
            start,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * space.dimension,
        ).x
        for start in _distinct(best)[:STARTS]
    ]
    # A discrete variable is where it can be.
    maxima = space.to_cube(space.to_contexts(np.clip(np.array(found), 0.0, 1.0)))
    return _distinct(maxima[np.argsort(-function(maxima), kind="stable")])


def _distinct(points: Sequence[Array] | Array, distance: float = DISTINCT) -> Array:
    """Points (n, e) without those that come after one that is not farther than a distance."""
    kept: list[Array] = []
    for point in points:
        if all(np.abs(point - other).max() > distance for other in kept):
            kept.append(point)
    return np.array(kept)


def _points(space: ContextSpace, contexts: Sequence[Mapping[str, float]]) -> Array:
    rows = np.array([[context[name] for name in space.names] for context in contexts])
    return space.to_cube(rows.reshape(-1, space.dimension))
