"""Evidence on the mean of bounded values at every time at once, by betting.

Whoever believes that the mean is less than m bets on it with each value x of a range [a, b], and
multiplies a wealth of 1 by 1 + λ (m - x). With 0 <= λ <= 1 / (b - m) the wealth is never negative,
and at a mean of m or more it has an expectation of 1 at most, whatever the law of the values: by
Ville's inequality it ever reaches 1/α with a probability of α at most. The wealth here is the mean
of those of several constant bets λ, small and large ("diversified Kelly betting").

References
----------
Waudby-Smith and Ramdas (2024). Estimating means of bounded random variables by betting. Journal of
the Royal Statistical Society, Series B 86(1), Sec. 4 and Appendix B.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from bo_tuner.numerics.arrays import Array

BETS = 0.5 ** np.arange(9.0)
"""The bets, as shares of the largest one that is possible: 1, 1/2, ... 1/256."""

SHARES = 1.0 / np.arange(1.0, 10.0)
"""What each bet gets of the wealth, not yet divided by their sum. The smaller bets get less: they
win only over many values, and so have the time to make up for it."""


def log_wealth(values: ArrayLike, mean: float, high: float) -> Array:
    """Return the log evidence after each of n values, that their expectation is less than `mean`.

    The lower end of the range plays no part: a bet that the mean is small loses by large values.

    Parameters
    ----------
    values
        Shape (n,), in their order, each at most `high`.
    mean
        The m of the hypothesis μ >= m. The evidence increases with it.
    high
        Upper end of the range. A mean beyond it is impossible: the evidence is infinite.
    """
    x = np.asarray(values, dtype=np.float64)
    if mean > high:
        return np.full(len(x), np.inf)
    if mean == high:
        # The mean can be `high` only if every value is.
        return np.where(np.logical_or.accumulate(x < high), np.inf, 0.0)
    with np.errstate(divide="ignore"):
        wealth = np.cumsum(np.log1p(BETS[:, None] * ((mean - x) / (high - mean))), axis=1)
    mixture: Array = logsumexp(wealth, axis=0, b=(SHARES / SHARES.sum())[:, None])
    return mixture
