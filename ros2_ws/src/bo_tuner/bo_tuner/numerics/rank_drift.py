"""Whether fresh values differ from a baseline: a group-sequential Mann-Whitney test.

After each of t fresh values U_t is the number of pairs of a fresh and a baseline value in which the
fresh one is larger, ties a half, and Z_t the same in standard deviations for values of one
distribution. It is tested after every value with the bound of O'Brien and Fleming (1979),

    |Z_t| ≥ c √(T / t),   t = 1 … T,

which asks for much at first and spends most of the error probability at the end. If baseline and
fresh values come from one distribution, all orders of them are equally probable, whatever it is
(Mann and Whitney 1947). So c is the quantile of max_t |Z_t| √(t / T) over random orders, with the
rule of a Monte Carlo test, by which the error probability is kept exactly; ties make it smaller.

That is the probability over baseline and fresh values. Whoever compares with one baseline again and
again has a rate of its own: with F the distribution of the metric, F of its values are n uniform
ones, and a comparison finds a difference as often as one with these and with uniform fresh ones. So
the quantile of this rate over baselines is known, too, whatever F is.

References
----------
Mann and Whitney (1947). On a test of whether one of two random variables is stochastically larger
than the other. The Annals of Mathematical Statistics 18(1).
O'Brien and Fleming (1979). A multiple testing procedure for clinical trials. Biometrics 35(3).
"""

from dataclasses import dataclass
from functools import lru_cache
from math import floor

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array

ORDERS = 20_000
"""Random orders by which the bound is set."""
SIMULATED = 2_000
"""Simulated comparisons by which the effect that is seen is found."""
BASELINES, NIGHTS = 200, 2_000
"""Simulated baselines, and comparisons with each, by which rates of false alarms are found."""
LARGEST_EFFECT = 20.0
"""In standard deviations; a larger one counts as not seen at all."""
BISECTIONS = 12
CHUNK = 500
"""Comparisons that are computed at once."""


@dataclass(frozen=True)
class RankTest:
    """The test with its numbers of values.

    Attributes
    ----------
    baseline
        Number n of baseline values.
    most
        Number T of fresh values at most.
    false_alarms
        Probability that it finds a difference where there is none, at most.
    """

    baseline: int
    most: int
    false_alarms: float

    @property
    def bound(self) -> float:
        """The c of the bound; infinite if no order is as improbable as that."""
        return _bound(self.baseline, self.most, self.false_alarms)

    def statistics(self, baseline: ArrayLike, fresh: ArrayLike) -> Array:
        """Return Z_t √(t / T) after each fresh value, shape (..., t).

        Parameters
        ----------
        baseline
            Shape (..., n).
        fresh
            Shape (..., t), with t ≤ T, in their order.
        """
        old = np.asarray(baseline, dtype=np.float64)[..., None, :]
        new = np.asarray(fresh, dtype=np.float64)[..., None]
        return self.scaled((new > old).sum(axis=-1) + 0.5 * (new == old).sum(axis=-1))

    def scaled(self, above: Array) -> Array:
        """Return the statistics by how many baseline values each fresh one is above, (..., t)."""
        n, t = float(self.baseline), np.arange(1.0, above.shape[-1] + 1.0)
        deviation = np.sqrt(n * t * (n + t + 1.0) / 12.0)
        scaled: Array = (np.cumsum(above, axis=-1) - 0.5 * n * t) / deviation
        return scaled * np.sqrt(t / self.most)

    def found_after(self, baseline: ArrayLike, fresh: ArrayLike) -> int | None:
        """Return after how many fresh values (t,) a difference was found; None if it was not.

        The baseline has shape (n,).
        """
        reached = np.abs(self.statistics(baseline, fresh)) >= self.bound
        return 1 + int(np.argmax(reached)) if reached.any() else None

    def rate(self, share: float) -> float:
        """Return the rate of false alarms that a share of all baselines do not exceed."""
        return _rate(self, share)

    def effect(self, power: float) -> float:
        """Return the shift of normal values that is found with a probability.

        Parameters
        ----------
        power
            The probability, between 0 and 1.

        Returns
        -------
        float
            In standard deviations; infinite if no shift is.
        """
        return _effect(self, power)


@lru_cache
def _bound(n: int, most: int, false_alarms: float) -> float:
    """Return the quantile of the largest statistic over random orders."""
    rng, test = np.random.default_rng(0), RankTest(n, most, false_alarms)
    largest = [
        np.abs(test.statistics(rng.random((CHUNK, n)), rng.random((CHUNK, most)))).max(axis=1)
        for _ in range(ORDERS // CHUNK)
    ]
    # Among the orders and the one that is tested, at most this many are as far out.
    allowed = floor(false_alarms * (ORDERS + 1))
    if not allowed:
        return np.inf
    # The test must reach what no more than `allowed` - 1 of the orders exceed, without equality.
    ordered = np.sort(np.concatenate(largest))[::-1]
    return float(np.nextafter(ordered[allowed - 1], np.inf))


@lru_cache
def _rate(test: RankTest, share: float) -> float:
    """Return the quantile of the rate over simulated baselines."""
    rng = np.random.default_rng(2)
    rates = []
    for _ in range(BASELINES):
        baseline, fresh = np.sort(rng.random(test.baseline)), rng.random((NIGHTS, test.most))
        above = np.searchsorted(baseline, fresh).astype(np.float64)
        found = (np.abs(test.scaled(above)) >= test.bound).any(axis=1)
        rates.append(float(np.mean(found)))
    return float(np.quantile(rates, share))


@lru_cache
def _effect(test: RankTest, power: float) -> float:
    """Return the smallest shift found with a probability, by bisection over simulated values."""
    rng = np.random.default_rng(1)
    chunks = [
        (rng.standard_normal((CHUNK, test.baseline)), rng.standard_normal((CHUNK, test.most)))
        for _ in range(SIMULATED // CHUNK)
    ]

    def share(shift: float) -> float:
        found = [
            (np.abs(test.statistics(old, new + shift)) >= test.bound).any(axis=1)
            for old, new in chunks
        ]
        return float(np.mean(found))

    if share(LARGEST_EFFECT) < power:
        return np.inf
    low, high = 0.0, LARGEST_EFFECT
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if share(middle) >= power else (middle, high)
    return high
