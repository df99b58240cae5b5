"""How far the noise of runs reaches, by its own residuals instead of a normal distribution.

A limit on single runs needs the quantile of the noise. Under a law with a long tail or a second
mode that is farther out than the normal one of the same variance, and a normal margin would promise
more than is kept. So where the residuals, each divided by the local standard deviation, contradict
a normal law, the quantile is bounded by theirs: of n values the r-th in ascending order is below
the quantile for P with the probability

    P(X >= r),  X ~ Binomial(n, P),

whatever the law (Wilks 1941), and the first one for which that is small is the bound. They
contradict it if they are skewed towards the limit (D'Agostino 1970), as those of two kinds of runs
are of which the rarer is the worse, or if more of them are beyond the normal quantile than a normal
law would put there by chance. Noise that differs from place to place is skewed now and then, too,
so skewness is tested at the level of `two_kinds`. Elsewhere the quantile is the normal one: that
bound differs from it by chance, and each half of a standard deviation costs as much in the
objective as the limit does. A residual at an observation that determines the mean there shows
nothing of the noise; its weight is the share that the mean leaves unexplained.

References
----------
D'Agostino (1970). Transformation to normality of the null distribution of g1. Biometrika 57(3).
Wilks (1941). Determination of sample sizes for setting tolerance limits. Annals of Mathematical
Statistics 12(1).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import betainc, ndtr, ndtri
from scipy.stats import kurtosis, skewtest

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.two_kinds import LEVEL

CHANCE = 0.05
"""Probability that residuals of a normal law contradict it, and that a bound is missed."""

FEWEST = 8
"""Residuals from which on the test of skewness holds."""

ALIKE = 1e-9
"""Share of their size by which residuals differ by rounding alone."""

TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class NoiseShape:
    """Standardized residuals of runs; build it by `of`.

    Attributes
    ----------
    residuals : ndarray, shape (N,)
        In local standard deviations, ascending.
    weights : ndarray, shape (N,)
        Part of each that its own observation does not explain, from 0 to 1.
    """

    residuals: Array
    weights: Array

    @classmethod
    def of(cls, residuals: Array, weights: Array) -> Self:
        """Sort residuals (N,) with their weights (N,)."""
        order = np.argsort(residuals, kind="stable")
        return cls(residuals[order], weights[order])

    def deviations(self, z: float, sign: float) -> float:
        """Return the standard deviations within which noise stays with the probability P = Φ(z).

        It is z, or where the residuals contradict that, an upper bound of their quantile for P, or
        the largest. It is at most √(P / (1 - P)), which bounds it for any law (Cantelli's
        inequality).

        Parameters
        ----------
        z
            Of the normal distribution.
        sign
            1 for noise upwards, -1 for noise downwards.
        """
        count = float(self.weights.sum())
        if z <= 0.0 or count < 1.0:
            return z
        probability = float(ndtr(z))
        residuals, weights = self.residuals, self.weights
        if sign < 0.0:
            residuals, weights = -residuals[::-1], weights[::-1]
        if not (self._is_skewed(sign) or _too_many_beyond(z, residuals, weights)):
            return z
        rank = np.cumsum(weights)
        missed = betainc(np.maximum(rank, TINY), np.maximum(count - rank, 0.0) + 1.0, probability)
        bound = residuals[min(int(np.sum(missed > CHANCE)), len(residuals) - 1)]
        return max(z, min(float(bound), float(np.sqrt(probability / (1.0 - probability)))))

    @cached_property
    def degrees(self) -> float:
        """Degrees of freedom of a squared residual: 2 / (κ - 1), with the kurtosis κ; 1 if normal.

        The variance of n residuals has the relative variance (κ - 1) / n. Few runs of a rare kind
        make κ large: what it is in one place, the runs near there do not tell.
        """
        if not any(map(self._is_skewed, (1.0, -1.0))):
            return 1.0
        return 2.0 / max(float(kurtosis(self._own, fisher=False)) - 1.0, 2.0)

    def _is_skewed(self, sign: float) -> bool:
        """Return whether the residuals have a longer tail on one side than a normal law."""
        return sign * self._skewness > float(ndtri(1.0 - LEVEL))

    @cached_property
    def _own(self) -> Array:
        """Those residuals that are mostly their own."""
        return self.residuals[self.weights > 0.5]

    @cached_property
    def _skewness(self) -> float:
        """Normal under a normal law."""
        own = self._own
        if len(own) < FEWEST or np.ptp(own) < ALIKE * np.abs(own).max():
            return 0.0
        return float(skewtest(own).statistic)


def _too_many_beyond(z: float, residuals: Array, weights: Array) -> bool:
    """Return whether more residuals are beyond z than a normal law puts there by chance."""
    beyond, count = float(weights[residuals > z].sum()), float(weights.sum())
    # The upper tail of a binomial law; counts need not be integers.
    return bool(beyond) and betainc(beyond, count - beyond + 1.0, ndtr(-z)) <= CHANCE
