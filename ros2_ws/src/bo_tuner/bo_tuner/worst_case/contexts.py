"""Shared parts of the worst-case searches: priors and swarm."""

from collections.abc import Callable
from math import sqrt

import numpy as np

from bo_tuner.models.hyperpriors import Hyperpriors, LogNormal
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context

SEARCH_EFFORT = SwarmSettings(particles=40, iterations=25, stall=6)

DECIDED = 2.0
"""Standard deviations between the constrained quantity and the limit that end a search."""

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
