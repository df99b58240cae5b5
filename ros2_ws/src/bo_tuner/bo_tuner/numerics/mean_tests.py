"""How a certificate shows that a mean over noise is within a limit: by what is known of the noise.

For a metric with a declared range, bets on its values show it, exactly, whatever the noise is.
Without a range three tests must all show it: the t mixture of `sequential`, which is exact for
normal noise, the same mixture with the statistic of a shifted log-normal law that is more skewed
than the sample (`numerics.skewed_means`), and bets as if the largest value that is known were the
end of the range. None of them covers rare values beyond all that were seen; no test without a
range can. So nothing is shown by fewer values than show a second kind that is not rarer than
`two_kinds.RARE`. A law of two kinds passes wrongly if none of the second is among so many values,
or if the bets are wrong: each has half of the error probability. Nothing is shown either once the
values are of two kinds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import exp, inf, log
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics import skewed_means
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.bounded_means import log_wealth
from bo_tuner.numerics.sequential import log_mean_evidence, log_t_evidence
from bo_tuner.numerics.two_kinds import gap, runs_to_see

GROWTH = 1.05
"""Factor between the numbers of values at which a skewed law is fitted: each fit takes time."""

HALVINGS = 60
"""Steps of a bisection for a bound."""


Reaches = Callable[[float, float], bool]
"""Takes a mean and a log evidence; whether the evidence that the expectation is less than the mean
reaches it. Monotone in the mean."""


class MeanTest(Protocol):
    """Shows that the expectation of values is small."""

    def of(self, values: Array) -> Reaches:
        """Return the test of what values (n,), n > 0, in their order have shown after any."""

    def fewest(self, limit: float, confidence: float) -> int:
        """Return how many values show a limit at least, however far within it they are."""


@dataclass(frozen=True)
class Betting:
    """For values of a known range: exact for each law.

    Attributes
    ----------
    low, high
        The range.
    """

    low: float
    high: float

    def of(self, values: Array) -> Reaches:  # noqa: D102
        return lambda mean, enough: bool((log_wealth(values, mean, self.high) >= enough).any())

    def fewest(self, limit: float, confidence: float) -> int:  # noqa: D102
        # The quickest are values that are all at the lower end.
        most = 1
        while True:
            evidence = log_wealth(np.full(most, self.low), limit, self.high)
            if evidence[-1] >= log(1.0 / (1.0 - confidence)):
                return 1 + int(np.argmax(evidence >= log(1.0 / (1.0 - confidence))))
            most *= 2


@dataclass(frozen=True)
class NormalOrSkewed:
    """For values without a known range: normal, log-normal with any shift, or of two kinds.

    Attributes
    ----------
    farthest
        Largest value that is known from elsewhere.
    """

    farthest: float = -inf

    def of(self, values: Array) -> Reaches:  # noqa: D102
        mixed, high = gap(values) is not None, max(self.farthest, float(values.max()))

        def skewed(mean: float, n: int) -> float:
            fitted = _fit(values[:n].tobytes())
            if fitted is None:
                return float(log_mean_evidence(values[:n], mean)[-1])
            return log_t_evidence(fitted.statistic(mean), n)

        def reaches(mean: float, enough: float) -> bool:
            least = _fewest(exp(-enough))
            if mixed or len(values) < least:
                return False
            if not (log_wealth(values, mean, high)[least - 1 :] >= enough + log(2.0)).any():
                return False
            normal = log_mean_evidence(values, mean)[least - 1 :]
            return bool((normal >= enough).any()) and any(
                skewed(mean, n) >= enough for n in reversed(_fitted_numbers(least, len(values)))
            )

        return reaches

    def fewest(self, limit: float, confidence: float) -> int:  # noqa: D102
        return _fewest(1.0 - confidence)


def is_mean_shown(values: ArrayLike, limit: float, confidence: float, test: MeanTest) -> bool:
    """Return whether values show with `confidence` that their expectation is within `limit`.

    Evidence after fewer values counts as well, unless the mean of all of them is beyond the limit.

    Parameters
    ----------
    values
        Shape (n,), in their order.
    limit
        Upper limit of the expectation.
    confidence
        Between 0 and 1.
    test
        The test, by what is known of the values.
    """
    sample = np.asarray(values, dtype=np.float64)
    if not len(sample) or float(sample.mean()) > limit:
        return False
    return test.of(sample)(limit, log(1.0 / (1.0 - confidence)))


def mean_bound(values: ArrayLike, confidence: float, test: MeanTest) -> float:
    """Return the upper confidence bound of the expectation, infinite where there is none yet.

    It is not below the mean of the values (n,), in their order, whatever earlier ones have shown.
    """
    sample = np.asarray(values, dtype=np.float64)
    if not len(sample):
        return inf
    reaches, enough = test.of(sample), log(1.0 / (1.0 - confidence))
    low = float(sample.mean())
    spread = max(float(sample.std()), 1e-9 * max(abs(low), 1.0))
    high = low + 1e6 * spread
    if isinstance(test, NormalOrSkewed):
        # Of values that are all alike the spread says nothing, and the largest one elsewhere does.
        high = max(high, test.farthest + spread)
    if isinstance(test, Betting):
        high = max(low, test.high)
    elif not reaches(high, enough):
        return inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if reaches(middle, enough):
            high = middle
        else:
            low = middle
    return high


def _fewest(error: float) -> int:
    """Return how many values show a rare kind, with half of the probability of an error."""
    return runs_to_see(1.0 - 0.5 * error)


@lru_cache(maxsize=1024)
def _fit(values: bytes) -> skewed_means.LogNormalFit | None:
    """Return the fit to values, which takes time: the same ones are asked for after each run."""
    return skewed_means.fit(np.frombuffer(values))


def _fitted_numbers(least: int, most: int) -> list[int]:
    """Return the numbers of values that a law is fitted to, each `GROWTH` times the one before."""
    sizes, n = [], least
    while n <= most:
        sizes.append(n)
        n = max(n + 1, round(n * GROWTH))
    return sizes
