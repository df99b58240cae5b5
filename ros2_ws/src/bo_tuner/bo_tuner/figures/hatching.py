"""Hatching: the diagonal lines with which an area of a grid is marked, the same for all renderers.

Unlike a colour, it hides nothing of a field below, and looks like none of the field's colours.
"""

import numpy as np
from numpy.typing import NDArray

from bo_tuner.figures.figure import Region

Array = NDArray[np.float64]

LINES = 22
"""Diagonals across the grid, from corner to corner."""
SAMPLES = 160
"""Points along each of them."""


def hatching(region: Region) -> tuple[Array, Array]:
    """Return lines over the area where the field of a region exceeds its level.

    Returns
    -------
    tuple of two ndarrays
        The points x (n,) and y (n,) of the lines one behind the other, with NaN between them. They
        are diagonals of the grid, so that their distance does not depend on the scale of an axis.
    """
    x, y = np.asarray(region.x, dtype=float), np.asarray(region.y, dtype=float)
    if len(x) < 2 or len(y) < 2:
        return np.empty(0), np.empty(0)
    offset, along = np.meshgrid(
        np.linspace(-1.0, 1.0, LINES + 2)[1:-1], np.linspace(0.0, 1.0, SAMPLES), indexing="ij"
    )
    u, v = along, along - offset
    level = _bilinear(np.asarray(region.z, dtype=float), u, np.clip(v, 0.0, 1.0))
    inside = (v >= 0.0) & (v <= 1.0) & (level > region.above)
    # A gap behind each line.
    drawn = np.pad(inside, [(0, 0), (0, 1)]).ravel()
    # One NaN is enough of a gap.
    kept = drawn | np.r_[False, drawn[:-1]]
    across, up = (
        np.where(drawn, _along(places, np.pad(w, [(0, 0), (0, 1)]).ravel()), np.nan)[kept]
        for places, w in ((x, u), (y, v))
    )
    return across, up


def _along(places: Array, share: Array) -> Array:
    """Return where shares (n,) of the way along the places of a grid are, 0 to 1."""
    places_at: Array = np.interp(share * (len(places) - 1), np.arange(len(places)), places)
    return places_at


def _bilinear(z: Array, u: Array, v: Array) -> Array:
    """Return the field z (rows, columns) at places u (...) across and v (...) up it, 0 to 1."""
    rows, columns = z.shape
    column, row = u * (columns - 1), v * (rows - 1)
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
