"""How far points are from a line of straight pieces, such as a plan."""

import numpy as np

from bo_tuner.numerics.arrays import Array

AT_ONCE = 1_000_000
"""Pairs of a point and a piece that are computed together, which limits the memory."""


def distances(points: Array, vertices: Array) -> Array:
    """Return the distance (n,) of points (n, d) from the nearest point of a line.

    Parameters
    ----------
    points
        The points (n, d).
    vertices
        The ends of its pieces (m, d), m ≥ 1, in their order; of a single one it is that point.
    """
    begin, along = vertices[:-1], np.diff(vertices, axis=0)
    if not len(along):
        begin, along = vertices, np.zeros_like(vertices)
    length = np.square(along).sum(axis=1)
    # A piece without length is a point: its beginning.
    length[length == 0.0] = 1.0
    nearest = np.empty(len(points))
    step = max(AT_ONCE // len(along), 1)
    for first in range(0, len(points), step):
        batch = points[first : first + step]
        away = batch[:, None, :] - begin  # (k, m - 1, d)
        share = np.clip((away * along).sum(axis=2) / length, 0.0, 1.0)
        rest = away - share[:, :, None] * along
        nearest[first : first + step] = np.sqrt(np.square(rest).sum(axis=2)).min(axis=1)
    return nearest
