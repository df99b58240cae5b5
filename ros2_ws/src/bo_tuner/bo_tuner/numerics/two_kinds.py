"""Whether values are of two kinds: they lie on two sides of a gap that no law of one mode leaves.

Beyond its mode a density decreases. So a value that is known to lie in [g, c], beyond the mode,
lies in [b, c], g < b < c, with a probability of (c - b) / (c - g) at most. Of the m values above a
gap (a, b) the largest is c, and the others then lie in [b, c] with at most

    ((c - b) / (c - g))^(m - 1).

The mode may lie within the gap. But then it leaves half of the gap on one side: with g its middle,
the bound holds of the values above or of those below, whichever side the mode is not on, and the
larger of the two bounds holds wherever the mode is. Each m is tested at the level / (m (m + 1)),
which sum to the level. Rounded values count as intervals of the smallest difference between them.
"""

from math import ceil, log, log1p, nan

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array

LEVEL = 1e-3
"""Probability, at a single look, with which values of one mode are taken for two kinds."""

RARE = 0.05
"""Share of the rarest kind that runs are to show."""


def gap(values: ArrayLike) -> float | None:
    """Return the middle of the gap between two kinds of values (n,); None if there is no gap."""
    bound, middle = _smallest(np.sort(np.asarray(values, dtype=np.float64)))
    return middle if bound < log(LEVEL) else None


def runs_to_see(confidence: float) -> int:
    """Return the number of runs that show a kind with the share `RARE` with a confidence.

    None of n runs is of the kind with a probability of (1 - RARE)^n.
    """
    return ceil(log1p(-confidence) / log1p(-RARE))


def _smallest(x: Array) -> tuple[float, float]:
    """Return the smallest log bound, by its share of the level, and the middle of its gap.

    The values (n,) are sorted.
    """
    distinct = np.unique(x)
    if len(distinct) < 2:
        return 0.0, nan
    # Two values alone may be as far apart as two kinds; three have a smallest difference.
    half = 0.5 * float(np.diff(distinct).min()) if len(distinct) > 2 else 0.0
    low, high = x[:-1] + half, x[1:] - half
    gaps = high > low
    low, high = low[gaps], high[gaps]
    if not len(low):
        return 0.0, nan
    below = np.flatnonzero(gaps).astype(np.float64) + 1.0
    middle = 0.5 * (low + high)
    top, bottom = x[-1] + half, x[0] - half
    upper = _log_share((top - high) / (top - middle), len(x) - below)
    lower = _log_share((low - bottom) / (middle - bottom), below)
    bounds = np.maximum(upper, lower)
    return float(bounds.min()), float(middle[int(np.argmin(bounds))])


def _log_share(share: Array, count: Array) -> Array:
    """Return the log bound of `count` values that all lie in a share of their interval."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # A single value, which ends the interval, shows nothing.
        shown = np.where(count > 1, (count - 1.0) * np.log(share), 0.0)
    bound: Array = shown + np.log(count * (count + 1.0))
    return bound
