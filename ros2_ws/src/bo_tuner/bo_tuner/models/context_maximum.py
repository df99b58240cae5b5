"""The context with the largest value of a function."""

from collections.abc import Callable

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.particle_swarm import SwarmSettings, maximize
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context

SEARCH_EFFORT = SwarmSettings(particles=40, iterations=25, stall=6)


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
