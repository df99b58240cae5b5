"""Whether two parameter sets differ by more than chance.

Default and tuned parameter set are evaluated in the same draws of context and noise, so the spread
between draws cancels from the difference of each pair; a Student interval of the mean of these
differences is the paired t interval (Box, Hunter and Hunter 2005, Sec. 3.2). What the context
explains of the differences is taken out of both (`numerics.adjusted_means`). Where the contexts
differ, which is so in the worst contexts of two parameter sets, the interval is Welch's (1947).

References
----------
Box, Hunter and Hunter (2005). Statistics for Experimenters, 2nd ed. Wiley.
Welch (1947). The generalization of "Student's" problem when several different population variances
are involved. Biometrika 34.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import frexp, inf, isfinite, ldexp, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from bo_tuner.numerics.adjusted_means import adjusted_mean
from bo_tuner.numerics.arrays import Array

ALIKE = 1e-9
"""Share of their size by which values differ by rounding alone."""
CONFIDENCE = 0.95
"""Two-sided confidence of every interval of a difference."""


class Change(StrEnum):
    """A change in words; `LOWER` and `HIGHER` of a metric that is neither objective nor limited."""

    BETTER = "better"
    WORSE = "worse"
    LOWER = "lower"
    HIGHER = "higher"
    NONE = "no measurable difference"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Difference:
    """A difference tuned minus default, in the metric's unit.

    Attributes
    ----------
    mean
        Estimate of the difference.
    low, high
        Ends of its interval with `CONFIDENCE`; infinite for fewer than two values.
    count
        Number of pairs, or the smaller of two samples.
    """

    mean: float
    low: float
    high: float
    count: int

    @property
    def interval_in_words(self) -> str:
        """The interval, with signs if neither side is shown, else as how far it is from 0."""
        ends = (self.low, self.high)
        if self.low <= 0.0 <= self.high:
            low, high = (f"{end:+.3g}" for end in ends)
        else:
            low, high = (f"{end:.3g}" for end in sorted(map(abs, ends)))
        return f"{100.0 * CONFIDENCE:g} % CI {low} to {high}"

    def change(self, sign: float) -> Change:
        """Return the difference in words."""
        if not (isfinite(self.low) and isfinite(self.high)):
            return Change.UNKNOWN
        if self.low <= 0.0 <= self.high:
            return Change.NONE
        falls = self.high < 0.0
        if sign == 0.0:
            return Change.LOWER if falls else Change.HIGHER
        return Change.BETTER if falls == (sign > 0.0) else Change.WORSE


def paired(default: ArrayLike, tuned: ArrayLike, covariates: Array) -> Difference:
    """Return the mean difference of pairs."""
    theirs, ours = (np.asarray(side, dtype=np.float64) for side in (default, tuned))
    differences = ours - theirs
    if len(differences) > 1:
        rounding = ALIKE * max(float(np.abs(theirs).max()), float(np.abs(ours).max()))
        if float(np.ptp(differences)) <= rounding:
            # The same noise in both cancels, and what is left of it is rounding.
            mean = float(np.median(differences))
            mean = mean if abs(mean) > rounding else 0.0
            return Difference(mean, mean, mean, len(differences))
    found = adjusted_mean(differences, covariates, CONFIDENCE)
    return Difference(found.mean, found.low, found.high, len(differences))


def unpaired(default: tuple[float, float, int], tuned: tuple[float, float, int]) -> Difference:
    """Return the difference of two means, each given with its standard error and sample size.

    The degrees of freedom are those of Welch (1947) and Satterthwaite.
    """
    (theirs, their_error, m), (ours, our_error, n) = default, tuned
    mean, count = ours - theirs, min(m, n)
    if count < 2:
        return Difference(mean, -inf, inf, count)
    # Divided by the same power of two: the fourth powers must not overflow.
    exponent = frexp(max(their_error, our_error))[1]
    their_error, our_error = ldexp(their_error, -exponent), ldexp(our_error, -exponent)
    variance = their_error**2 + our_error**2
    freedom = (
        variance**2 / (their_error**4 / (m - 1) + our_error**4 / (n - 1))
        if variance > 0.0
        else float(m + n - 2)
    )
    half = ldexp(float(stdtrit(freedom, 0.5 * (1.0 + CONFIDENCE))) * sqrt(variance), exponent)
    return Difference(mean, mean - half, mean + half, count)
