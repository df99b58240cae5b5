"""Hatching: the diagonal lines with which an area of a grid is marked, the same for all renderers.

Unlike a colour, it hides nothing of a field below, and looks like none of the field's colours.
"""

import numpy as np
from numpy.typing import NDArray

from bo_tuner.figures.figure import Region, Scale, Values

Array = NDArray[np.float64]

LINES = 22
"""Diagonals across the axes, from corner to corner."""
SAMPLES = 160
"""Points along each of them."""


def hatching(
    region: Region, x_scale: Scale = Scale.LINEAR, y_scale: Scale = Scale.LINEAR
) -> tuple[Array, Array]:
    """Return lines over the area where the field of a region exceeds its level."""
    if len(region.x) < 2 or len(region.y) < 2:
        return np.empty(0), np.empty(0)
    offset, along = np.meshgrid(
        np.linspace(-1.0, 1.0, LINES + 2)[1:-1], np.linspace(0.0, 1.0, SAMPLES), indexing="ij"
    )
    u, v = along, along - offset
    x, column = _along(region.x, x_scale, u)
    y, row = _along(region.y, y_scale, np.clip(v, 0.0, 1.0))
    level = _bilinear(np.asarray(region.z, dtype=float), column, row)
    inside = (v >= 0.0) & (v <= 1.0) & (level > region.above)
    # A gap behind each line.
    drawn = np.pad(inside, [(0, 0), (0, 1)]).ravel()
    # One NaN is enough of a gap.
    kept = drawn | np.r_[False, drawn[:-1]]
    across, up = (
        np.where(drawn, np.pad(w, [(0, 0), (0, 1)]).ravel(), np.nan)[kept] for w in (x, y)
    )
    return across, up


def _along(values: Values, scale: Scale, share: Array) -> tuple[Array, Array]:
    """Return values at shares of the way along an axis, and which place of the grid that is."""
    places = np.asarray(values, dtype=float)
    places = np.log(places) if scale is Scale.LOG else places
    at = places[0] + share * (places[-1] - places[0])
    index: Array = np.interp(at, places, np.arange(len(places)))
    return np.exp(at) if scale is Scale.LOG else at, index


def _bilinear(z: Array, column: Array, row: Array) -> Array:
    """Return the field z (rows, columns) between its places."""
    rows, columns = z.shape
    j = np.minimum(column.astype(int), columns - 2)
    i = np.minimum(row.astype(int), rows - 2)
    s, t = column - j, row - i
    interpolated: Array = (
        z[i, j] * (1 - s) * (1 - t)
        + z[i, j + 1] * s * (1 - t)
        + z[i + 1, j] * (1 - s) * t
        + z[i + 1, j + 1] * s * t
    )
    return interpolated
