"""Estimates and confidence bounds from a sample: of a probability, a mean and a tail mean.

References
----------
Clopper and Pearson (1934). The use of confidence or fiducial limits illustrated in the case of the
binomial. Biometrika 26(4).
Rockafellar and Uryasev (2000). Optimization of conditional value-at-risk. Journal of Risk 2(3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
from scipy.special import betaincinv, stdtrit

from bo_tuner.numerics.arrays import Array

ROUNDING = 1e-12
"""A bound that exceeds a probability by no more than this counts as equal to it."""


def probability_bound(events: int, draws: int, confidence: float) -> float:
    """Return the exact upper confidence bound of a probability (Clopper and Pearson 1934).

    It is the p with P(X <= events) = 1 - confidence for X ~ Binomial(draws, p): whatever the true
    probability is, the bound lies below it with probability 1 - confidence at most.

    Parameters
    ----------
    events, draws
        Number of draws in which the event happened, and of all draws, at least 1.
    confidence
        Between 0 and 1.

    Raises
    ------
    ValueError
        Unless 0 <= events <= draws and draws >= 1.
    """
    if not (0 <= events <= draws and draws >= 1):
        raise ValueError(f"expected 0 <= events <= draws >= 1, found {events} of {draws}")
    if events == draws:
        return 1.0
    return float(betaincinv(events + 1, draws - events, confidence))


def draws_needed(allowed: float, confidence: float) -> int:
    """Return the smallest number of draws that, without any event, show a probability.

    Parameters
    ----------
    allowed
        The probability that the bound must not exceed, between 0 and 1.
    confidence
        As in `probability_bound`.
    """
    needed = max(1, ceil(log(1.0 - confidence) / log(1.0 - allowed) - 1e-9))
    while not is_shown(0, needed, allowed, confidence):
        needed += 1
    return needed


def is_shown(events: int, draws: int, allowed: float, confidence: float) -> bool:
    """Return whether a sample shows with `confidence` that a probability is at most `allowed`."""
    return probability_bound(events, draws, confidence) <= allowed + ROUNDING


def most_events(draws: int, allowed: float, confidence: float) -> int:
    """Return the largest number of events for which `is_shown` is true; -1 if there is none."""
    events = 0
    while events <= draws and is_shown(events, draws, allowed, confidence):
        events += 1
    return events - 1


@dataclass(frozen=True)
class Mean:
    """A sample mean with its uncertainty.

    Attributes
    ----------
    value
        Mean of the sample.
    standard_error
        Of `value`; NaN for fewer than two values.
    upper
        Upper confidence bound of the true mean by Student's t; infinite for fewer than two values.
    """

    value: float
    standard_error: float
    upper: float


def mean_of(values: Sequence[float] | Array, confidence: float) -> Mean:
    """Return the mean of independent values, its standard error and upper confidence bound.

    Parameters
    ----------
    values
        Shape (n,).
    confidence
        Of the bound, between 0 and 1.
    """
    sample = np.asarray(values, dtype=np.float64)
    count = len(sample)
    if count < 2:
        return Mean(float(sample[0]) if count else float("nan"), float("nan"), float("inf"))
    value, error = float(sample.mean()), float(sample.std(ddof=1)) / sqrt(count)
    return Mean(value, error, value + float(stdtrit(count - 1, confidence)) * error)


def conditional_value_at_risk(values: Sequence[float] | Array, level: float) -> float:
    """Return the mean of the largest values, a fraction 1 - level of the sample.

    If that is not a whole number of values, the smallest of them has a fractional weight
    (Rockafellar and Uryasev 2000, for a discrete distribution).

    Parameters
    ----------
    values
        Shape (n,); larger is worse. An empty sample gives NaN.
    level
        Between 0 and 1; 0.95 averages the worst 5 %.
    """
    sample = np.sort(np.asarray(values, dtype=np.float64))[::-1]
    if not len(sample):
        return float("nan")
    size = (1.0 - level) * len(sample)
    weights = np.clip(size - np.arange(len(sample)), 0.0, 1.0)
    return float(weights @ sample / size)
