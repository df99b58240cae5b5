"""How far an estimated trajectory is from the true one.

Reference: Z. Zhang and D. Scaramuzza, *A Tutorial on Quantitative Trajectory Evaluation for
Visual(-Inertial) Odometry*, IROS 2018.
"""

import numpy as np
from numpy.typing import NDArray

from bo_tuner.numerics.arrays import Array


def absolute_errors(truth: Array, estimate: Array, *, align: bool) -> Array:
    """Return the distances (n,) of an estimate from the truth, both (n, d) with d = 2 or 3 [m].

    With `align`, after the rotation and translation of the estimate that make the sum of their
    squares the smallest (section III-B, without a scale): for odometry, whose frame is its own.
    """
    if align:
        centre, other = truth.mean(axis=0), estimate.mean(axis=0)
        # S. Umeyama, IEEE PAMI 13 (1991) 376-380, Eq. 40-42.
        u, _, vt = np.linalg.svd((truth - centre).T @ (estimate - other))
        turn = np.eye(len(u))
        turn[-1, -1] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
        estimate = (estimate - other) @ (u @ turn @ vt).T + centre
    distances: Array = np.linalg.norm(estimate - truth, axis=1)
    return distances


def relative_errors(
    times: Array, truth: Array, yaw: Array, estimate: Array, estimated_yaw: Array, over: float
) -> tuple[Array, Array]:
    """Return by how much an estimate drifts over a time (section IV-B).

    Parameters
    ----------
    times
        Times (n,) [s], increasing.
    truth, estimate
        Positions (n, 2) [m], each in a frame of its own.
    yaw, estimated_yaw
        Headings (n,) [rad].
    over
        The time [s].

    Returns
    -------
    times, errors
        At times (m,) [s], the distance [m] between the way since the time `over` ago, seen from
        where it began, and the estimated one; empty if the trajectory is shorter.
    """
    # Of a drive without gaps the first one at which so much time has passed.
    before = np.searchsorted(times, times - over + 1e-9 * over, side="right") - 1
    later = np.flatnonzero(before >= 0)
    first = before[later]
    own = _ways(estimate, estimated_yaw, first, later)
    distances: Array = np.linalg.norm(_ways(truth, yaw, first, later) - own, axis=1)
    return times[later], distances


def _ways(position: Array, yaw: Array, first: NDArray[np.intp], later: NDArray[np.intp]) -> Array:
    """Return the ways (m, 2) [m] from some places to others, seen from the former."""
    way = position[later] - position[first]
    cos, sin = np.cos(yaw[first]), np.sin(yaw[first])
    return np.column_stack([cos * way[:, 0] + sin * way[:, 1], -sin * way[:, 0] + cos * way[:, 1]])
