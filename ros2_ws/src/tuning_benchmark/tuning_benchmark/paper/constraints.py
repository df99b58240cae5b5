"""Limits on responses that are modelled trial by trial."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.special import ndtri

from bo_tuner.models.constraints import LimitedResponse
from bo_tuner.models.protocol import Model
from bo_tuner.numerics.arrays import Array


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
