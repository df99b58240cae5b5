"""Whether a response depends on one coordinate, by points that an optimizer has chosen.

The other coordinates matter, too, and the chosen points depend on what was observed before: where
it was good, all coordinates have been near the same values. So the part of the others is a Gaussian
process, y = β₀ + hᵀ β + g(others) + ε, in which the coordinate u has the columns h = (u, u²), or of
a choice one for each value but the first. Given the covariance of g + ε but for its scale, this is
generalized least squares, and after whitening the linear model of `numerics.linear_effects`.

The kernel of g has the length scales that were fitted to all coordinates; the share of the noise is
estimated anew for each coordinate, by restricted maximum likelihood (Patterson and Thompson 1971)
beside β: what the fit has explained by a coordinate that does nothing is noise then. The degrees of
freedom of the residuals are less those of the smoother, the trace of K (K + σ² I)⁻¹.

References
----------
Patterson and Thompson (1971). Recovery of inter-block information when block sizes are unequal.
Biometrika 58.
"""

import numpy as np

from bo_tuner.models.categories import Coding
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.kernel import correlation
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.linear_effects import LinearEffect, linear_effect

NOISE = np.logspace(-4.0, 4.0, 33)
"""Variances of the noise, in that of the process, among which the estimate is."""
PLAUSIBLE = 1.0
"""Log likelihood by which a share of the noise may be below the best one: of those that may be so,
the one with the least evidence counts."""
BETWEEN = np.linspace(0.0, 1.0, 5)
"""Values of a number, in the unit cube, between which its effect is the largest difference."""


def dependences(
    points: Array,
    response: Array,
    coding: Coding,
    count: int,
    level: float,
    rng: np.random.Generator,
) -> list[LinearEffect]:
    """Test for each of the leading coordinates whether a response depends on it.

    Parameters
    ----------
    points
        Points of the unit cube, shape (n, d).
    response
        Their responses, shape (n,).
    coding
        Which coordinates are choices.
    count
        How many of the coordinates are tested.
    level
        Probability, for each of them, that one that does nothing is taken for one that does.
    rng
        Of the fit.
    """
    encoded = coding.encode(points)
    scales = GaussianProcess.fit(encoded, response, rng=rng).length_scales
    groups = coding.spread(np.arange(points.shape[1]))
    return [
        _dependence(
            response, encoded[:, groups != k], scales[groups != k], *_factor(points[:, k], m), level
        )
        for k, m in enumerate([*coding.levels, *[0] * count][:count])
    ]


def _factor(values: Array, levels: int) -> tuple[Array, Array]:
    """Return the columns (n, q) of a coordinate (n,), and the contrasts (m, q) between its values.

    Parameters
    ----------
    values
        The coordinate, in the unit cube.
    levels
        Number of values of a choice; 0 for a number.
    """
    at = np.linspace(0.0, 1.0, levels) if levels else BETWEEN

    def columns(u: Array) -> Array:
        if levels:
            chosen = np.rint(u[:, None] * (levels - 1)) == np.arange(1, levels)
            return np.asarray(chosen, dtype=np.float64)
        return np.stack([u, u**2], axis=1) if len(np.unique(values)) > 2 else u[:, None]

    first, second = np.triu_indices(len(at), 1)
    between = columns(at)
    return columns(values), between[second] - between[first]


def _dependence(
    response: Array,
    others: Array,
    scales: Array,
    factor: Array,
    contrasts: Array,
    level: float,
) -> LinearEffect:
    n = len(response)
    process = correlation(others, others, scales) if others.shape[1] else np.zeros((n, n))
    variances, vectors = np.linalg.eigh(process)
    variances = np.maximum(variances, 0.0)
    turned = vectors.T @ np.column_stack([response, np.ones(n), factor])
    likelihoods = np.array([_restricted_likelihood(turned, variances + noise) for noise in NOISE])
    plausible = NOISE[likelihoods >= likelihoods.max() - PLAUSIBLE]
    effects = [_given_noise(turned, variances, noise, contrasts, level) for noise in plausible]
    return max(effects, key=lambda effect: effect.p_value)


def _given_noise(
    turned: Array, variances: Array, noise: float, contrasts: Array, level: float
) -> LinearEffect:
    whitened = turned / np.sqrt(variances + noise)[:, None]
    y, ones, own = whitened[:, 0], whitened[:, 1:2], whitened[:, 2:]
    spent = float((variances / (variances + noise)).sum())
    return linear_effect(y, ones, own, contrasts, level, spent=spent)


def _restricted_likelihood(turned: Array, variances: Array) -> float:
    """Return the restricted log likelihood, up to a constant, with the scale at its best.

    Parameters
    ----------
    turned
        Response and columns in the basis of the eigenvectors of the covariance, shape (n, 1 + p).
    variances
        Its eigenvalues, shape (n,).
    """
    y, *columns = (turned / np.sqrt(variances)[:, None]).T
    q, r = np.linalg.qr(np.stack(columns, axis=1))
    sizes = np.abs(np.diag(r))
    independent = sizes > 1e-9 * sizes.max()
    rest = y - q[:, independent] @ (q[:, independent].T @ y)
    degrees = len(y) - int(independent.sum())
    squares = max(float(rest @ rest), np.finfo(float).tiny)
    determinant = np.log(variances).sum() + 2.0 * np.log(sizes[independent]).sum()
    return float(-0.5 * (degrees * np.log(squares) + determinant))
