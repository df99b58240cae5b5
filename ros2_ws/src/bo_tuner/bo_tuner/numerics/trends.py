"""Whether values that should be alike change with their order: Spearman's rank correlation.

Without a trend every order of the values is as probable as any other, whatever their law. The rank
correlation ρ of n values with their order then has a known distribution, of which
ρ √((n - 2) / (1 - ρ²)) is taken for Student's t with n - 2 degrees of freedom (Kendall and Gibbons
1990, Sec. 4.15).

References
----------
Kendall and Gibbons (1990). Rank Correlation Methods, 5th ed. Arnold.
"""

from math import inf, sqrt

import numpy as np
from scipy.special import stdtr

from bo_tuner.numerics.arrays import Array

FEWEST = 10
"""Values from which on the distribution is near enough to Student's."""


def trend(values: Array) -> tuple[float, float]:
    """Return the rank correlation of values (n,) with their order, and its two-sided p-value.

    Of fewer than `FEWEST` values, or equal ones, nothing can be said: 0 and 1.
    """
    n = len(values)
    ranks = _ranks(values)
    if n < FEWEST or float(np.ptp(ranks)) == 0.0:
        return 0.0, 1.0
    rho = float(np.corrcoef(ranks, np.arange(n))[0, 1])
    rest = 1.0 - rho * rho
    t = abs(rho) * sqrt((n - 2) / rest) if rest > 0.0 else inf
    return rho, 2.0 * float(stdtr(n - 2, -t))


def _ranks(values: Array) -> Array:
    """Return the ranks (n,), equal values with the mean of theirs."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    ranks: Array = (last - 0.5 * (counts - 1))[inverse]
    return ranks
