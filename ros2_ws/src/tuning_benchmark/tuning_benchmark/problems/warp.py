"""The warp of the parameters of closed forms, so that no surrogate has it easy."""

import numpy as np

from bo_tuner.numerics.arrays import Array


def warped(u: Array) -> Array:
    """Return x = u + sin(2πu) / (4π) of points u of the cube, any shape; it is increasing."""
    result: Array = u + np.sin(2.0 * np.pi * u) / (4.0 * np.pi)
    return result


def unwarped(x: Array) -> Array:
    """Return u of x, by bisection."""
    low, high = np.zeros_like(x), np.ones_like(x)
    for _ in range(60):
        middle = (low + high) / 2.0
        below = warped(middle) < x
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    result: Array = (low + high) / 2.0
    return result
