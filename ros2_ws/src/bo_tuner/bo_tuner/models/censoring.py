"""Censored observations: of a run that was cut short a metric is known to be at least its bound.

With normal noise the likelihood of a censored observation at the place z_i is that of the Tobit
model, P(y_i >= b_i) = Φ((f_i - b_i) / τ_i), where τ_i is the noise there. Expectation propagation
replaces each of these factors by a normal one, an observation m̃_i with a noise variance λ_i, such
that the posterior of f_i has the mean and the variance that the factor itself gives it (Groot and
Lucas 2012; the moments are those of Rasmussen and Williams 2006, Eq. 3.58). Far beyond its bound an
observation so tells nothing, and nowhere as much as one of a whole run: λ_i >= τ_i².

Notation: k censored observations with bounds b; f_i has the mean m_i and the variance v_i, and
without its own factor the mean μ_i and the variance s_i².

References
----------
Groot and Lucas (2012). Gaussian process regression with censored data using expectation
propagation. 6th European Workshop on Probabilistic Graphical Models.
Rasmussen and Williams (2006). Gaussian Processes for Machine Learning, Sec. 3.6. MIT Press.
Tobin (1958). Estimation of relationships for limited dependent variables. Econometrica 26(1).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_normal_cdf, log_normal_pdf

MOST_UNCERTAIN = 1e4
"""Largest λ, in variances of the response: such an observation tells nothing."""

DAMPING = 0.7
"""Part of the way to its new value that each factor goes: all are updated at once."""

ROUNDS = 100
"""Most updates of all factors."""

CONVERGED = 1e-4
"""Change of the mean of each f_i, in standard deviations of the response, that ends the updates."""


@dataclass(frozen=True, eq=False)
class Censored:
    """Observations of which a lower bound is known.

    Attributes
    ----------
    x, c : ndarray, shapes (k, d) and (k, e)
        Parameter sets and contexts in their unit cubes.
    bounds : ndarray, shape (k,)
        In the unit of the response.
    """

    x: Array
    c: Array
    bounds: Array

    def __len__(self) -> int:
        return len(self.bounds)

    def on_scale(self, apply: Callable[[Array], Array]) -> "Censored":
        """Return them on another scale, by an increasing map that need not exist everywhere.

        A bound that is not on that scale, such as 0 on a logarithmic one, tells nothing.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            bounds = apply(self.bounds)
        known = np.isfinite(bounds)
        return Censored(self.x[known], self.c[known], bounds[known])


Marginals = Callable[[Array, Array], tuple[Array, Array]]
"""Returns m and v (k,) for factors with the means and the variances (k,)."""


def normal_factors(marginals: Marginals, bounds: Array, noise: Array) -> tuple[Array, Array]:
    """Return the observations (k,) that stand for censored ones, and their noise variances (k,).

    Parameters
    ----------
    marginals
        Conditions on all data with such observations; responses are standardized.
    bounds : ndarray, shape (k,)
        b.
    noise : ndarray, shape (k,)
        τ².
    """
    means, precisions = bounds.copy(), np.full(len(bounds), 1.0 / MOST_UNCERTAIN)
    before = np.full(len(bounds), np.inf)
    for _ in range(ROUNDS):
        mean, variance = marginals(means, 1.0 / precisions)
        if np.abs(mean - before).max() < CONVERGED:
            break
        before = mean
        left = np.maximum(1.0 / variance - precisions, 1.0 / MOST_UNCERTAIN)
        without = (mean / variance - precisions * means) / left
        goal, precise = _factor(without, 1.0 / left, bounds, noise)
        # The natural parameters of a factor are what is damped.
        product = (1.0 - DAMPING) * precisions * means + DAMPING * precise * goal
        precisions = (1.0 - DAMPING) * precisions + DAMPING * precise
        means = product / precisions
    return means, 1.0 / precisions


def _factor(mean: Array, variance: Array, bounds: Array, noise: Array) -> tuple[Array, Array]:
    """Return mean and precision (k,) of the factors, by μ and s² (k,) without them."""
    spread = variance + noise
    z = (mean - bounds) / np.sqrt(spread)
    # φ(z) / Φ(z), which is never below -z.
    ratio = np.maximum(np.exp(log_normal_pdf(z) - log_normal_cdf(z)), np.finfo(np.float64).tiny)
    curvature = np.clip(ratio * (z + ratio), np.finfo(np.float64).tiny, 1.0) / spread
    precision = 1.0 / np.clip(1.0 / curvature - variance, noise, MOST_UNCERTAIN)
    shift = np.minimum(ratio / np.sqrt(spread) / curvature, MOST_UNCERTAIN)
    return mean + shift, precision
