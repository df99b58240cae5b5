"""How far the noise of runs reaches, by its own residuals instead of a normal distribution.

A limit on single runs needs the quantile of the noise. Under a law with a long tail or a second
mode that is farther out than the normal one of the same variance, and a normal margin would promise
more than is kept. So where more residuals are beyond the normal quantile than a normal law would
put there by chance, the quantile is that of the residuals, each divided by the local standard
deviation (as in split conformal prediction, Lei and others 2018). Elsewhere it is the normal one:
the quantile of some hundred residuals differs from it by chance, and each half of a standard
deviation costs as much in the objective as the limit does. A residual at an observation that
determines the mean there shows nothing of the noise; its weight is the share that the mean leaves
unexplained.

References
----------
Lei, G'Sell, Rinaldo, Tibshirani and Wasserman (2018). Distribution-free predictive inference for
regression. Journal of the American Statistical Association 113(523).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import betainc, ndtr

from bo_tuner.numerics.arrays import Array

CHANCE = 0.05
"""Probability of as many residuals beyond the normal quantile from which on they are chance."""


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

        It is z, or where the residuals contradict that, their quantile for P (1 + 1 / n) with n of
        them, which a further one exceeds with a probability of at most 1 - P, or the largest. It is
        at most √(P / (1 - P)), which bounds it for any law (Cantelli's inequality).

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
        beyond = float(weights[residuals > z].sum())
        # The upper tail of a binomial law; counts need not be integers.
        if not beyond or betainc(beyond, count - beyond + 1.0, 1.0 - probability) > CHANCE:
            return z
        share = (np.cumsum(weights) - 0.5 * weights) / count
        own = float(np.interp(probability * (1.0 + 1.0 / count), share, residuals))
        return max(z, min(own, float(np.sqrt(probability / (1.0 - probability)))))
