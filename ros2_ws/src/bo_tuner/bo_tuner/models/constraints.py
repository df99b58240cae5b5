"""Probability that a response keeps its limit, from its surrogate model."""

from abc import ABC, abstractmethod
from collections.abc import Iterable

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_normal_cdf

BELIEVED_FEASIBLE = 0.5
"""Lowest probability of feasibility of a parameter set that counts as feasible."""

CONFIDENT = 0.975
"""Lowest probability of feasibility of the answer of an algorithm with pooled evaluations."""


class LimitedResponse(ABC):
    """Limit on an uncertain response, in its unit: an upper one, or with the `sign` -1 a lower."""

    limit: float
    sign: float

    @abstractmethod
    def predict(self, x: Array) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the constrained latent response at x (m, d)."""

    def predict_mean(self, x: Array) -> Array:
        """Return the mean (m,) alone at x (m, d); a response may know a cheaper way."""
        return self.predict(x)[0]

    def band(self, x: Array, deviations: float) -> tuple[Array, Array, Array]:
        """Return mean, lower and upper end (m,) of a band, in standard deviations."""
        mean, variance = self.predict(x)
        half = deviations * np.sqrt(variance)
        return mean, mean - half, mean + half

    def log_probability(self, x: Array) -> Array:
        """Return the log probability (m,) that the constraint holds at x (m, d)."""
        return self.log_kept(*self.predict(x))

    def log_kept(self, mean: Array, variance: Array) -> Array:
        """Return the log probability (m,) that normal responses keep the limit."""
        # Rounding can make the variance zero; the logarithm must still be finite.
        sd = np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        with np.errstate(over="ignore"):  # log Φ accepts an infinite argument
            return log_normal_cdf((self.sign * self.limit - self.sign * mean) / sd)

    def excess(self, x: Array) -> Array:
        """Return by how much the mean response (m,) at x (m, d) violates the limit."""
        return self.sign * (self.predict_mean(x) - self.limit)

    def least_log_probability(self, x: Array) -> Array:
        """Return the least `log_probability` (m,) of all contexts that the response knows."""
        return self.log_probability(x)

    def estimate(self, x: Array) -> tuple[Array, float, float] | None:
        """Return the worst context (e,) of x (1, d), in the unit cube, and the metric there.

        That is its mean and its noise's standard deviation, in the metric's unit. None if the
        response does not know the contexts, or the limit is not one in each of them.
        """
        return None


def log_feasibility(constraints: Iterable[LimitedResponse], x: Array) -> Array:
    """Return the log probability (m,) that all constraints hold at x (m, d)."""
    total = np.zeros(len(x))
    for constraint in constraints:
        total += constraint.log_probability(x)
    return total
