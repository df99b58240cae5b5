"""Whether a response depends on a factor: the F test of a linear hypothesis, and its power.

Model of n responses: y = X γ + H β + ε, ε ~ N(0, σ² I), where the columns of X (n, p) are what else
there is, those of H (n, q) the factor. The hypothesis β = 0, that the factor does nothing, is
tested with F = (βᵀ A β / q) / s², where A = H̃ᵀ H̃ of the part H̃ of H that X does not explain and
s² is the variance of the residuals, with ν = n - p - q degrees of freedom. Otherwise F has a
noncentral F distribution with the noncentrality δ = βᵀ A β / σ² (Scheffé 1959, Sections 2.4, 2.6).

The smallest effect that would have been seen. An effect is the largest of some contrasts |lₖᵀ β|,
such as the differences between the values of the factor. Among all β with the effect e, δ is least
for e² / (σ² maxₖ lₖᵀ A⁻¹ lₖ): with one contrast fixed at e, the least βᵀ A β is e² / lₖᵀ A⁻¹ lₖ,
and by the inequality of Cauchy and Schwarz no other contrast is larger there for the k of the
maximum.

References
----------
Scheffé (1959). The Analysis of Variance. Wiley.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import fdtrc, fdtri, ncfdtr

from bo_tuner.numerics.arrays import Array

POWER = 0.9
"""Probability with which the smallest effect that would have been seen is seen."""
ROUNDING = 1e-9
"""Share of the largest response below which differences are rounding."""
LARGEST_NONCENTRALITY = 1e5


@dataclass(frozen=True)
class LinearEffect:
    """The effect of a factor on a response.

    Attributes
    ----------
    p_value
        Probability of as large an F of a factor that does nothing; 1 if no effect can be estimated.
    change
        The contrast that is largest in size, in the unit of the response; 0 if none is known.
    contrast
        Its number.
    visible
        Smallest effect that would have been seen with the probability `POWER`, in that unit, if the
        noise is as estimated; 0 without noise, infinite if no effect can be estimated.
    noise
        Standard deviation of the noise, in that unit.
    """

    p_value: float
    change: float
    contrast: int
    visible: float
    noise: float


NOTHING_KNOWN = LinearEffect(1.0, 0.0, 0, float("inf"), float("nan"))
NO_EFFECT = LinearEffect(1.0, 0.0, 0, 0.0, 0.0)
"""The effect of a factor on a response without noise that never changes."""


def linear_effect(
    response: Array,
    others: Array,
    factor: Array,
    contrasts: Array,
    level: float,
    *,
    spent: float = 0.0,
) -> LinearEffect:
    """Test whether a response depends on a factor.

    Parameters
    ----------
    response
        y, shape (n,).
    others
        X, shape (n, p).
    factor
        H, shape (n, q).
    contrasts
        The lₖ, shape (m, q).
    level
        Probability that a factor that does nothing is taken for one that does.
    spent
        Degrees of freedom that were spent on estimating the whitening of the responses.
    """
    basis, values, _ = np.linalg.svd(others, full_matrices=False)
    basis = basis[:, values > ROUNDING * max(float(values.max(initial=0.0)), 1.0)]
    rest = response - basis @ (basis.T @ response)
    own = factor - basis @ (basis.T @ factor)
    u, sizes, vt = np.linalg.svd(own, full_matrices=False)
    nonzero = sizes > ROUNDING * max(float(sizes.max(initial=0.0)), 1.0)
    rank, degrees = int(nonzero.sum()), len(response) - basis.shape[1] - int(nonzero.sum())
    if rank == 0 or degrees < 1:
        return NOTHING_KNOWN
    u, sizes, vt = u[:, nonzero], sizes[nonzero], vt[nonzero]
    explained = u.T @ rest
    known = contrasts @ vt.T
    changes = known @ (explained / sizes)
    largest = int(np.argmax(np.abs(changes)))
    change = float(changes[largest])
    residual = rest - u @ explained
    squares, size = float(residual @ residual), float(np.abs(response).max())
    estimable = np.allclose(known @ vt, contrasts)
    if squares <= degrees * (ROUNDING * size) ** 2:
        p_value = float(abs(change) <= ROUNDING * size)
        return LinearEffect(p_value, change, largest, 0.0 if estimable else np.inf, 0.0)
    variance, degrees = squares / degrees, max(degrees - round(spent), 1)
    ratio = float(explained @ explained) / rank / variance
    spread = np.sqrt(((known / sizes) ** 2).sum(axis=1).max())
    visible = spread * np.sqrt(variance * noncentrality(rank, degrees, level))
    return LinearEffect(
        p_value=float(fdtrc(rank, degrees, ratio)),
        change=change,
        contrast=largest,
        visible=float(visible) if estimable else np.inf,
        noise=float(np.sqrt(variance)),
    )


@cache
def noncentrality(rank: int, degrees: int, level: float) -> float:
    """Return the noncentrality that an F test of a level finds with the probability `POWER`."""
    critical = fdtri(rank, degrees, 1.0 - level)

    def missed(noncentral: float) -> float:
        return float(ncfdtr(rank, degrees, noncentral, critical)) - (1.0 - POWER)

    upper = 1.0
    while not missed(upper) <= 0.0:
        upper *= 2.0
        if upper > LARGEST_NONCENTRALITY:
            return float("inf")
    return float(brentq(missed, 0.0, upper, xtol=1e-9, rtol=1e-9))
