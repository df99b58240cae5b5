"""Means and shares with what their numbers of runs leave open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Mean:
    """A mean with its confidence interval; NaN without values, no interval for a single one."""

    value: float
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class Share:
    """A count of successes with the confidence interval of their probability."""

    count: int
    runs: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """Observed share."""
        return self.count / self.runs


@dataclass(frozen=True)
class Exponent:
    """Fitted power law y = factor x^value, with the confidence interval of the exponent."""

    value: float
    low: float
    high: float
    factor: float


def mean(values: Sequence[float]) -> Mean:
    """Mean with Student's t interval."""
    count = len(values)
    if count == 0:
        return Mean(np.nan, np.nan, np.nan, 0)
    value = float(np.mean(values))
    if count == 1:
        return Mean(value, np.nan, np.nan, 1)
    half = float(stats.sem(values) * stats.t.ppf(0.5 + CONFIDENCE / 2, count - 1))
    return Mean(value, value - half, value + half, count)


def share(count: int, runs: int) -> Share:
    """Share with the interval of Clopper and Pearson (1934)."""
    interval = stats.binomtest(count, runs).proportion_ci(CONFIDENCE, method="exact")
    return Share(count, runs, float(interval.low), float(interval.high))


def difference(first: Sequence[float], second: Sequence[float]) -> Mean:
    """Difference of two means, first minus second, with the interval of Welch (1947)."""
    if min(len(first), len(second)) < 2:
        return Mean(np.nan, np.nan, np.nan, min(len(first), len(second)))
    result = stats.ttest_ind(first, second, equal_var=False)
    interval = result.confidence_interval(CONFIDENCE)
    value = float(np.mean(first) - np.mean(second))
    low, high = float(interval.low), float(interval.high)
    return Mean(value, low, high, min(len(first), len(second)))


def exponent(x: Sequence[float], y: Sequence[float]) -> Exponent:
    """Fit a power law to positive values by least squares of their logarithms."""
    fit = stats.linregress(np.log(x), np.log(y))
    degrees = len(x) - 2
    half = float(fit.stderr * stats.t.ppf(0.5 + CONFIDENCE / 2, degrees)) if degrees > 0 else np.nan
    slope = float(fit.slope)
    return Exponent(slope, slope - half, slope + half, float(np.exp(fit.intercept)))
