"""Shared parts of the worst-case searches: priors, swarm and starting contexts."""

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np

from bo_tuner.models.hyperpriors import Hyperpriors, LogNormal
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context, WorstCase

SEARCH_EFFORT = SwarmSettings(particles=40, iterations=25, stall=6)

DECIDED = 2.0
"""Standard deviations between the constrained quantity and the limit that end a search."""

DISTINCT = 0.1
"""Contexts closer than this in every coordinate of the unit cube count as equal."""

# A few evaluations cannot distinguish noise from a short length scale. The priors state what is
# expected of a plant in a bounded box: a smooth response, on which the context has more influence
# than noise.
PRIORS = Hyperpriors(
    length_scale=LogNormal(0.7, 0.5, 0.1, 20.0),
    signal=LogNormal(1.0, 0.5, 0.05, 20.0),
    noise=LogNormal(0.15, 0.5, 1e-3, 3.0),
)


def is_clear(distance: float, variance: float, asked: int) -> bool:
    """Return whether a limit is kept or violated for sure, at a distance above the mean."""
    error = DECIDED * sqrt(variance)
    # A model with few data can be overconfident: the limit counts as kept only after an evaluation
    # at the maximum of the upper confidence bound.
    return distance < -error or (distance > error and asked > 0)


def maximize_over_contexts(
    space: ContextSpace,
    function: Callable[[Array], Array],
    rng: np.random.Generator,
    initial: Array,
) -> tuple[Context, float]:
    """Maximize a function of the context by a small particle swarm.

    Parameters
    ----------
    space
        The context space.
    function
        Maps contexts (m, e) of the unit cube to values (m,).
    rng
        Draws the moves of the swarm.
    initial
        Contexts (k, e) of the unit cube to start from, besides the corners.

    Returns
    -------
    context
        The context with the largest value, by variable name in its own unit.
    value
        Value of the function in it.
    """
    maximum = maximize(
        function,
        space.dimension,
        rng,
        repair=lambda x: space.to_cube(space.to_contexts(x)),
        initial=np.vstack([initial, space.corners()]),
        settings=SEARCH_EFFORT,
    )
    return space.to_dict(space.to_contexts(maximum.position[None])[0]), maximum.value


def worst_contexts_nearby(
    point: Array,
    tried: Array,
    worst_cases: Sequence[WorstCase],
    space: ContextSpace,
    count: int,
) -> list[Context]:
    """Return the worst contexts of the nearest parameter sets, without duplicates.

    Parameters
    ----------
    point
        Parameter set (d,) in the unit cube.
    tried
        Parameter sets (n, d) with a known worst case.
    worst_cases
        Worst cases of the n parameter sets.
    space
        The context space.
    count
        Largest number of contexts; they are taken from 1.5 times as many neighbours.
    """
    if space.dimension == 0:
        return []
    chosen: list[Context] = []
    nearest = np.argsort(((tried - point) ** 2).sum(axis=1), kind="stable")
    for index in nearest[: count + (count + 1) // 2]:
        candidate = worst_cases[int(index)].context
        if all(_distance(candidate, other, space) > DISTINCT for other in chosen):
            chosen.append(candidate)
    return [dict(context) for context in chosen[:count]]


def _distance(a: Context, b: Context, space: ContextSpace) -> float:
    rows = space.cube_of([a, b])
    return float(np.abs(rows[0] - rows[1]).max())
