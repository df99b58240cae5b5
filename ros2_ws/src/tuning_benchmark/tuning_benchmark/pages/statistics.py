"""Means and shares with confidence intervals, and tests of their differences."""

from collections.abc import Mapping, Sequence
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
class Power:
    """Fitted power law y = factor x^exponent."""

    exponent: float
    factor: float


def mean(values: Sequence[float], confidence: float = CONFIDENCE) -> Mean:
    """Mean with Student's t interval."""
    count = len(values)
    if count == 0:
        return Mean(np.nan, np.nan, np.nan, 0)
    value = float(np.mean(values))
    if count == 1:
        return Mean(value, np.nan, np.nan, 1)
    half = float(stats.sem(values) * stats.t.ppf(0.5 + confidence / 2, count - 1))
    return Mean(value, value - half, value + half, count)


def share(count: int, runs: int) -> Share:
    """Share with the interval of Clopper and Pearson (1934)."""
    interval = stats.binomtest(count, runs).proportion_ci(CONFIDENCE, method="exact")
    return Share(count, runs, float(interval.low), float(interval.high))


def difference(
    first: Mapping[int, float], second: Mapping[int, float], confidence: float = CONFIDENCE
) -> Mean:
    """Mean difference, first minus second, of the seeds that both have, with Student's t interval.

    Runs with one seed share their initial samples and their validation's draws, so that they are
    pairs; what they have in common cancels.
    """
    return mean([first[seed] - second[seed] for seed in first if seed in second], confidence)


def fisher(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Probability that two counts of successes, each with its runs, differ so much by chance.

    The two-sided exact test of Fisher (1922) for one common probability of success.
    """
    table = [[count, runs - count] for count, runs in (first, second)]
    return float(stats.fisher_exact(table).pvalue)


def mcnemar(only_first: int, only_second: int) -> float:
    """Probability that so many pairs differ in one direction by chance.

    The two-sided exact test of McNemar (1947): of the pairs in which just one succeeds, each of
    both is as likely to be that one. 1 without such pairs.
    """
    pairs = only_first + only_second
    return float(stats.binomtest(only_first, pairs).pvalue) if pairs else 1.0


def power(x: Sequence[float], y: Sequence[float]) -> Power:
    """Fit a power law to positive values by least squares of their logarithms."""
    slope, offset = np.polyfit(np.log(x), np.log(y), 1)
    return Power(float(slope), float(np.exp(offset)))
