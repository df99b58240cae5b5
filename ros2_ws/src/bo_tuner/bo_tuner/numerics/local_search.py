"""Ascent from a point of the unit cube, by differences: what a swarm found, to many more digits."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from bo_tuner.numerics.arrays import Array

STEP = 1e-6
"""Of the forward differences."""
DEPTH = 1e4
"""So far below the start counts as excluded: a line search needs numbers."""


def ascend(
    objective: Callable[[Array], Array],
    start: Array,
    repair: Callable[[Array], Array],
    iterations: int = 60,
) -> tuple[Array, float]:
    """Maximize a function over the unit cube from a start, by L-BFGS-B.

    Parameters
    ----------
    objective : callable
        Maps positions, shape (m, d), to values, shape (m,); -inf or NaN excludes a position.
    start : ndarray, shape (d,)
        An admissible position with a finite value.
    repair : callable
        Maps positions, shape (m, d), to the nearest admissible ones. Where it rounds, the
        function looks flat, and that coordinate stays.
    iterations : int
        Largest number of them, ≥ 1.

    Returns
    -------
    ndarray, shape (d,)
        The best admissible position that was asked for.
    float
        Objective there, no less than at the start.
    """
    (value,) = objective(start[None])
    best, highest = start.copy(), float(value)
    lowest = highest - DEPTH

    def descent(position: Array) -> tuple[float, Array]:
        nonlocal best, highest
        # Inwards, so that the cube is not left.
        steps = np.where(position > 0.5, -STEP, STEP)
        asked = repair(np.vstack([position, position + np.diag(steps)]))
        values = np.fmax(objective(asked), lowest)
        if values[0] > highest:
            best, highest = asked[0].copy(), float(values[0])
        return -float(values[0]), (values[0] - values[1:]) / steps

    limits = {"maxiter": iterations, "maxfun": 2 * iterations}
    bounds = [(0.0, 1.0)] * len(start)
    minimize(descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options=limits)
    return best, highest
