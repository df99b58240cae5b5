"""Laws of noise with mean 0 and standard deviation 1, as maps of standard normal draws.

Each law is a mixture of normal distributions, with the density Σ_i w_i φ((n - m_i) / s_i) / s_i.
Its distribution function F is known, so n = F⁻¹(Φ(z)) with a standard normal z has the law: the
same draw z gives a run of each law, and the quantile for P is the run of z = Φ⁻¹(P).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from bo_tuner.numerics.arrays import Array

HALVINGS = 80
"""Bisections for a quantile, to the last bit of its interval."""

REACH = 9.0
"""Standard deviations of a part of a mixture beyond which nothing of it is drawn."""


@dataclass(frozen=True)
class NoiseLaw:
    """A mixture of normal distributions; build it by `standardized`.

    Attributes
    ----------
    weights, means, deviations
        Probability, mean and standard deviation of each part.
    """

    weights: tuple[float, ...] = (1.0,)
    means: tuple[float, ...] = (0.0,)
    deviations: tuple[float, ...] = (1.0,)

    @classmethod
    def standardized(cls, *parts: tuple[float, float, float]) -> Self:
        """Return the mixture of parts (weight, mean, deviation), with mean 0 and deviation 1."""
        w, m, s = np.array(parts).T
        mean = w @ m
        scale = np.sqrt(w @ (s**2 + (m - mean) ** 2))
        return cls(tuple(w), tuple((m - mean) / scale), tuple(s / scale))

    def kept(self, n: ArrayLike) -> Array:
        """Return the probability F of noise of at most n, shape as `n`."""
        z = (np.asarray(n, dtype=np.float64)[..., None] - self.means) / self.deviations
        result: Array = ndtr(z) @ np.array(self.weights)
        return result

    def of_normal(self, z: ArrayLike) -> Array:
        """Return the noise F⁻¹(Φ(z)) of standard normal draws, shape as `z`."""
        draws = np.asarray(z, dtype=np.float64)
        if len(self.weights) == 1:
            return draws
        means, deviations = np.array(self.means), np.array(self.deviations)
        low = np.full(draws.shape, (means - REACH * deviations).min())
        high = np.full(draws.shape, (means + REACH * deviations).max())
        probability = ndtr(draws)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            below = self.kept(middle) < probability
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return high


NORMAL, LOGNORMAL, BIMODAL, SPIKES = "normal", "lognormal", "bimodal", "spikes"

LAWS: Mapping[str, NoiseLaw] = {
    NORMAL: NoiseLaw(),
    # On the metric's logarithm.
    LOGNORMAL: NoiseLaw(),
    # One run in five ends far above the others, like a second way through an obstacle.
    BIMODAL: NoiseLaw.standardized((0.8, 0.0, 0.3), (0.2, 2.5, 0.3)),
    # One run in twenty, like a message that came late.
    SPIKES: NoiseLaw.standardized((0.95, 0.0, 0.3), (0.05, 4.0, 0.5)),
}
"""Laws by their names in a problem's settings."""
