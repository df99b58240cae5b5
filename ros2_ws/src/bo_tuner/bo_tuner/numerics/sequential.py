"""Confidence bounds that hold after every evaluation at once (anytime-valid).

A bound for a fixed number n of draws holds if it is computed once: whoever computes it after each
draw and stops at the first good one is wrong far more often than stated. The bounds here come from
a test martingale, a non-negative process E_n that has expectation 1 at most if the hypothesis is
true. By Ville's inequality it ever reaches 1/α with probability α at most, however one stops. So
an evaluation may end as soon as the evidence suffices, and be continued as long as it does not.

*Probability.* The hypothesis is q ≥ p, with k events among n draws. The likelihood ratio of q' < p
against p has an expectation of 1 at most for each q ≥ p, and so has its mixture over q',

    E_n = ∫_0^p (q'/p)^k ((1 - q')/(1 - p))^(n - k) w(q') dq',   w(q') = 1 / (2 √(p q')),

an incomplete beta function (Robbins 1970; Howard et al. 2021, Sec. 3).

*Mean of a normal quantity whose deviation σ is not known.* The hypothesis is a mean μ ≥ m. With
S and V the sums of y - m and (y - m)², the prior N(0, 1) on (μ - m)/σ, cut at zero, and the right
Haar prior 1/σ on σ give

    E_n = 2 T_n(-t) √(1 / (n + 1)) (1 - S² / ((n + 1) V))^(-n/2),
    t = S √(n / ((n + 1) V - S²)),

where T_n is Student's distribution function (Lai 1976; Wang and Ramdas 2025). At μ = m it is a
martingale, and it increases with m, so that the bound covers the true mean with the confidence.

References
----------
Robbins (1970). Statistical methods related to the law of the iterated logarithm. The Annals of
Mathematical Statistics 41(5).
Lai (1976). On confidence sequences. The Annals of Statistics 4(2).
Howard, Ramdas, McAuliffe and Sekhon (2021). Time-uniform, nonparametric, nonasymptotic confidence
sequences. The Annals of Statistics 49(2).
Wang and Ramdas (2025). Anytime-valid t-tests and confidence sequences for Gaussian means with
unknown variance. Sequential Analysis 44(1).
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from math import log

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betainc, betaln, stdtr, xlog1py, xlogy

from bo_tuner.numerics.arrays import Array

HALVINGS = 60
"""Steps of a bisection; the interval shrinks to the rounding of its ends."""


def log_evidence(events: ArrayLike, probability: ArrayLike) -> Array:
    """Return log E_n after each of n draws, that an event is less likely than `probability`.

    Parameters
    ----------
    events
        Whether each draw had the event, shape (n,), in the order of the draws.
    probability
        The p of the hypothesis q >= p, between 0 and 1; one, or one after each draw (n,).
    """
    happened = np.asarray(events, dtype=bool)
    n = np.arange(1.0, len(happened) + 1.0)
    return log_evidence_of_counts(np.cumsum(happened), n, probability)


def log_evidence_of_counts(k: ArrayLike, n: ArrayLike, probability: ArrayLike) -> Array:
    """Return log E_n of k events among n draws; all of one shape, or scalar.

    The k need not be whole numbers: an expected number gives about what is to be expected.
    """
    k, n, p = np.asarray(k), np.asarray(n), np.asarray(probability, dtype=np.float64)
    with np.errstate(divide="ignore"):
        mixture = betaln(k + 0.5, n - k + 1.0) + np.log(betainc(k + 0.5, n - k + 1.0, p))
        evidence: Array = mixture - np.log(2.0 * np.sqrt(p)) - xlogy(k, p) - xlog1py(n - k, -p)
    return evidence


def log_mean_evidence(values: ArrayLike, mean: ArrayLike) -> Array:
    """Return log E_n after each of n values, that their expectation is less than `mean`.

    Parameters
    ----------
    values
        Shape (n,), in their order.
    mean
        The m of the hypothesis μ >= m; one, or one after each value (n,).
    """
    sample = np.asarray(values, dtype=np.float64)
    n = np.arange(1.0, len(sample) + 1.0)
    m = np.asarray(mean, dtype=np.float64)
    # Around a value of the sample, so that the differences of large numbers stay accurate.
    shift = sample[0] if len(sample) else 0.0
    first, second = np.cumsum(sample - shift), np.cumsum((sample - shift) ** 2)
    s = first - n * (m - shift)
    v = np.maximum(second - 2.0 * (m - shift) * first + n * (m - shift) ** 2, s**2 / n)
    rest = v - s**2 / (n + 1.0)
    # Values that all equal m are no evidence.
    known = rest > 0.0
    rest = np.where(known, rest, 1.0)
    ratio = np.where(known, v, 1.0) / rest
    return np.where(known, _evidence_of_ratio(s > 0.0, ratio, n), 0.0)


def log_t_evidence(t: float, n: int) -> float:
    """Return log E_n of n values with the t statistic `t` of a hypothetical mean."""
    if not np.isfinite(t):
        return np.inf if t < 0.0 else -np.inf
    share = t * t / (n - 1.0 + t * t)
    ratio = 1.0 / (1.0 - share * n / (n + 1.0))
    return float(_evidence_of_ratio(np.array(t > 0.0), np.array(ratio), np.array(float(n))))


def _evidence_of_ratio(above: ArrayLike, ratio: Array, n: Array) -> Array:
    """Return log E_n by whether S > 0, and V / (V - S² / (n + 1))."""
    t = np.where(above, 1.0, -1.0) * np.sqrt(n * np.maximum(ratio - 1.0, 0.0))
    with np.errstate(divide="ignore"):
        evidence: Array = (
            log(2.0) + np.log(stdtr(n, -t)) - 0.5 * np.log1p(n) + 0.5 * n * np.log(ratio)
        )
    return evidence


def probability_bounds(events: ArrayLike, confidence: float) -> Array:
    """Return upper confidence bounds of an event's probability after each draw, shape (n,).

    All of them hold at once with `confidence`, so each is the lowest so far, but not below the
    share of the events: if the probability drifts, as on a machine that warms up, the share can
    exceed an earlier bound.

    Parameters
    ----------
    events
        Whether each draw had the event, shape (n,), in the order of the draws.
    confidence
        Between 0 and 1.
    """
    happened = np.asarray(events, dtype=bool)
    n = np.arange(1.0, len(happened) + 1.0)
    share = np.cumsum(happened) / n
    largest = _largest(
        lambda p: log_evidence(happened, p), share, np.ones(len(happened)), confidence
    )
    bounds: Array = np.maximum(np.minimum.accumulate(largest), share)
    return bounds


def mean_bounds(values: ArrayLike, confidence: float) -> Array:
    """Return upper confidence bounds of a normal mean after each value, shape (n,).

    All of them hold at once with `confidence`, so each is the lowest so far, but not below the
    mean of the values, which can exceed an earlier bound if it drifts. The first ones can be
    infinite.

    Parameters
    ----------
    values
        Shape (n,), in their order.
    confidence
        Between 0 and 1.
    """
    sample = np.asarray(values, dtype=np.float64)
    if not len(sample):
        return sample
    n = np.arange(1.0, len(sample) + 1.0)
    mean = np.cumsum(sample) / n
    spread = np.sqrt(np.maximum(np.cumsum(sample**2) / n - mean**2, 0.0))
    # With few values, or a high confidence, no mean at all is refuted.
    far = mean + 1e6 * np.maximum(spread, 1e-9 * np.maximum(np.abs(mean), 1.0))
    never = log_mean_evidence(sample, far) < log(1.0 / (1.0 - confidence))
    largest = _largest(lambda m: log_mean_evidence(sample, m), mean, far, confidence)
    return np.maximum(np.minimum.accumulate(np.where(never, np.inf, largest)), mean)


def is_shown(events: Sequence[bool], allowed: float, confidence: float) -> bool:
    """Return whether draws show with `confidence` that an event has at most `allowed`.

    Evidence after fewer draws counts as well, unless the share of all of them exceeds `allowed`.
    """
    share = float(np.mean(np.asarray(events, dtype=bool))) if len(events) else 0.0
    return share <= allowed and _reached(log_evidence(events, allowed), confidence)


def is_refuted(events: ArrayLike, allowed: float, confidence: float) -> bool:
    """Return whether draws show with `confidence` that an event has at least `allowed`."""
    other = ~np.asarray(events, dtype=bool)
    return _reached(log_evidence(other, 1.0 - allowed), confidence)


def is_mean_refuted(values: ArrayLike, limit: float, confidence: float) -> bool:
    """Return whether values show with `confidence` that their expectation exceeds `limit`."""
    return _reached(log_mean_evidence(-np.asarray(values, dtype=np.float64), -limit), confidence)


def is_hopeless(events: Sequence[bool], most: int, allowed: float, confidence: float) -> bool:
    """Return whether draws cannot show an `allowed` probability any more, up to `most` of them.

    For this the event is taken to be absent from all further draws.
    """
    future = [*events, *[False] * (most - len(events))]
    return not is_shown(future, allowed, confidence)


def draws_needed(allowed: float, confidence: float) -> int:
    """Return the smallest number of draws that, without any event, show a probability.

    Parameters
    ----------
    allowed
        The probability, between 0 and 1.
    confidence
        Between 0 and 1.
    """

    def shown(draws: int) -> bool:
        return _reached(log_evidence_of_counts(0, float(draws), allowed), confidence)

    # Without any event the evidence increases with the number of draws.
    low, high = 0, 1
    while not shown(high):
        low, high = high, 2 * high
    return bisect_left(range(low, high), True, key=shown) + low


FIRST = 0.8
"""Share of the error probability that the first of many attempts gets."""


def spent(confidence: float, attempt: int, subjects: int = 1) -> float:
    """Return the confidence for one attempt of many, counted from 1, that have `confidence` in all.

    Most studies are certified once, so the first attempt gets the share `FIRST` of the error
    probability, and attempt j > 1 the share 1 / (j (j - 1)) of the rest; the shares sum to one.
    The share of an attempt is divided among its `subjects`, the parameter sets that it judges.
    """
    share = FIRST if attempt == 1 else (1.0 - FIRST) / (attempt * (attempt - 1))
    return 1.0 - (1.0 - confidence) * share / subjects


def _reached(evidence: Array, confidence: float) -> bool:
    return bool(_at_least(evidence, confidence).any())


def _at_least(evidence: Array, confidence: float) -> NDArray[np.bool_]:
    enough: NDArray[np.bool_] = evidence >= log(1.0 / (1.0 - confidence))
    return enough


def _largest(
    evidence: Callable[[Array], Array], low: Array, high: Array, confidence: float
) -> Array:
    """Return the largest parameters (n,) that the evidence, increasing in them, does not refute."""
    enough = log(1.0 / (1.0 - confidence))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        refuted = evidence(middle) >= enough
        low, high = np.where(refuted, low, middle), np.where(refuted, middle, high)
    return high
