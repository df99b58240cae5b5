"""Probability that a response keeps its limit, from its surrogate model."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.special import ndtri

from bo_tuner.models.protocol import Model
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


@dataclass(frozen=True, eq=False)
class SurrogateConstraint(LimitedResponse):
    """Limit on the latent response itself, f(x) ≤ limit, or ≥ for a lower one.

    As it is, for a response whose noise is the error of an estimate and must not count, such as a
    worst case over contexts that is estimated from noisy evaluations; `on_observation` makes one
    for a limit on single observations.

    Attributes
    ----------
    model : Model
        Surrogate of the response.
    limit : float
        Limit of the latent response, in its unit.
    sign : float
        1 for an upper limit, -1 for a lower one.
    """

    model: Model
    limit: float
    sign: float = 1.0

    @classmethod
    def on_observation(
        cls, model: Model, limit: float, probability: float, sign: float = 1.0
    ) -> Self:
        """Constrain single observations: P[y(x) ≤ limit] ≥ probability (paper, Eq. 3d).

        With y = f(x) + ε and ε ~ N(0, σ²) the constraint holds if and only if
        f(x) + z σ ≤ limit, z = Φ⁻¹(probability). So the noise lowers the limit by z σ, and only
        f(x) remains uncertain. It raises a lower limit as much.

        Raises
        ------
        ValueError
            If `probability` is not in (0, 1).
        """
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability: expected a value in (0, 1), found {probability}")
        z = float(ndtri(probability))
        return cls(model, limit - sign * z * model.noise_variance**0.5, sign)

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the constrained latent response at x (m, d)."""
        return self.model.predict(x)

    def predict_mean(self, x: Array) -> Array:
        """Return the mean (m,) alone at x (m, d)."""
        return self.model.predict_mean(x)


@dataclass(frozen=True, eq=False)
class JointConstraint(SurrogateConstraint):
    """Limit on the worst case of a metric over the contexts, by the joint model.

    Attributes
    ----------
    model : Model
        Over joint points (d + e columns).
    limit : float
        Limit of the latent worst case, in the metric's unit.
    sign : float
        1 for an upper limit, -1 for a lower one.
    contexts : ndarray, shape (k, e)
        Candidate contexts in the unit cube.
    """

    contexts: Array = field(kw_only=True)

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Return mean and variance (m,) in the worst candidate context of each x (m, d)."""
        worst = (self.sign * self._means(x)).argmax(axis=1)
        return self.model.predict(np.hstack([x, self.contexts[worst]]))

    def predict_mean(self, x: Array) -> Array:
        """Return the mean (m,) alone in the worst candidate context of each x (m, d)."""
        worst: Array = self.sign * (self.sign * self._means(x)).max(axis=1)
        return worst

    def _means(self, x: Array) -> Array:
        """Return the mean (m, k) at x (m, d) in each candidate context."""
        joint = np.hstack(
            [np.repeat(x, len(self.contexts), axis=0), np.tile(self.contexts, (len(x), 1))]
        )
        return self.model.predict_mean(joint).reshape(len(x), -1)
