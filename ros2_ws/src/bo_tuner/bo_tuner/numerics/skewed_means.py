"""Evidence on the mean of a skewed quantity: a log-normal one, shifted by an unknown amount.

The t statistic takes the noise for normal. A sample of a quantity with rare large values often has
none of them, and then both its mean and its deviation are too small. Here x - θ is taken to be
log-normal. The shift θ is the one at which log(x - θ) has a skewness of one standard error to the
left: of the laws of this family that agree with the sample, one of the most skewed. But θ stays so
far from the smallest value that the law is not far more skewed than the sample. With n values, the
mean and variance of log(x - θ) give the signed root of the likelihood ratio that x has the mean m,

    r² = n min_v (log v + (v̂ + (D + v/2)²) / v) - n (log v̂ + 1),   D = mean(log((x - θ) / (m - θ))),

with the minimum at v = 2 (√(1 + Q) - 1), Q = v̂ + D². For a normal quantity r² = n log(1 + t²/(n-1))
with the t statistic of the sample, so that t² = (n - 1)(exp(r²/n) - 1) stands for it in a test that
is made for normal noise. As θ → -∞ the family becomes the normal one. The level is no theorem; it
is measured (benchmarks/band_coverage.py).

References
----------
Wu, Wong and Jiang (2003). Likelihood-based confidence intervals for a log-normal mean. Statistics
in Medicine 22(11).
"""

from dataclasses import dataclass
from math import exp, inf, log, log1p, sqrt

import numpy as np

from bo_tuner.numerics.arrays import Array

ERRORS = 1.0
"""Standard errors of the skewness by which the law may be more skewed than the sample."""

TIMES = 3.0
"""How many times as skewed as the sample, two standard errors added, the law may be: if a law has
rare large values, the skewness of a sample is too small by such a factor."""

STEPS = 32
"""Steps of the bisection for the shift."""

EQUAL = 1e-12
"""Standard deviation, in sizes of the values, up to which they differ by rounding alone."""

NEAREST, FARTHEST = 1e-9, 1e4
"""Distance of the shift from the smallest value, in standard deviations, at least and at most."""


@dataclass(frozen=True)
class LogNormalFit:
    """Fit of a shifted log-normal law to a sample.

    Attributes
    ----------
    count
        Number of values.
    shift
        The θ, smaller than all values.
    mean, variance
        Of log(x - θ) in the sample.
    """

    count: int
    shift: float
    mean: float
    variance: float

    def root(self, mean: float) -> float:
        """Return the signed root r of the likelihood ratio, for an expectation of `mean`.

        Negative where the expectation by the fit is less than `mean`.
        """
        if mean <= self.shift:
            return inf
        d = self.mean - log(mean - self.shift)
        q = self.variance + d * d
        v = 2.0 * q / (sqrt(1.0 + q) + 1.0)
        half = 0.5 * (log(v / self.variance) + q / v + d + 0.25 * v - 1.0)
        size = sqrt(2.0 * self.count * max(half, 0.0))
        return size if d + 0.5 * self.variance > 0.0 else -size

    def statistic(self, mean: float) -> float:
        """Return the t statistic that is as unlikely for a normal quantity as `root` for this."""
        r = self.root(mean)
        size = sqrt((self.count - 1.0) * _expm1(r * r / self.count))
        return size if r > 0.0 else -size


def fit(values: Array) -> LogNormalFit | None:
    """Return the fit to a sample; None if it is skewed to the left, or has no spread.

    Parameters
    ----------
    values
        Shape (n,), n >= 3.
    """
    n, lowest, deviation = len(values), float(values.min()), float(values.std())
    # Standard error of the skewness of n normal values.
    error = sqrt(6.0 * (n - 2.0) / ((n + 1.0) * (n + 3.0)))
    if deviation <= EQUAL * float(np.abs(values).max()):
        return None
    skewness = _skewness(values)
    if skewness <= -ERRORS * error:
        return None
    most, above = TIMES * (max(skewness, 0.0) + 2.0 * error), values - lowest

    def is_possible(logarithms: Array) -> bool:
        return (
            _skewness(logarithms) > -ERRORS * error
            and _log_normal_skewness(float(logarithms.var())) < most
        )

    near, far = log(NEAREST), log(FARTHEST)
    for _ in range(STEPS):
        middle = 0.5 * (near + far)
        if is_possible(np.log(above + deviation * exp(middle))):
            far = middle
        else:
            near = middle
    distance = deviation * exp(far)
    logarithms = np.log(above + distance)
    return LogNormalFit(n, lowest - distance, float(logarithms.mean()), float(logarithms.var()))


def _log_normal_skewness(variance: float) -> float:
    """Return the skewness of a log-normal law by the variance of its logarithm."""
    if variance > 50.0:
        return inf
    return (exp(variance) + 2.0) * sqrt(float(np.expm1(variance)))


def _skewness(values: Array) -> float:
    centred = values - values.mean()
    return float((centred**3).mean() / (centred**2).mean() ** 1.5)


def _expm1(value: float) -> float:
    """Return exp(value) - 1, infinite where that overflows."""
    return (
        inf if value > 700.0 else exp(value) - 1.0 if value > log1p(1.0) else float(np.expm1(value))
    )
