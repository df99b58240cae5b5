"""Logarithms of densities, probabilities and expected improvement, stable for extreme inputs.

Acquisition functions are compared far out in their tails, where the values themselves underflow to
zero; their logarithms still rank the points.

References
----------
Ament, Daulton, Eriksson, Balandat and Bakshy (2023). Unexpected improvements to expected
improvement for Bayesian optimization. NeurIPS 36.
"""

import numpy as np
from scipy.special import erfcx, gammaln, log_ndtr

from bo_tuner.numerics.arrays import Array

LOG_SQRT_2PI = 0.5 * float(np.log(2.0 * np.pi))
SQRT_HALF_PI = float(np.sqrt(0.5 * np.pi))
# Beyond this many standard deviations z² would overflow.
LARGEST_Z = 1e150
# From here on the closed form of log h loses digits to cancellation; its series is exact.
SERIES_FROM = 100.0


def log_normal_pdf(z: Array) -> Array:
    """Return log φ(z), the log density of the standard normal distribution, shape as `z`."""
    clipped = np.clip(z, -LARGEST_Z, LARGEST_Z)
    return -0.5 * clipped**2 - LOG_SQRT_2PI


def log_normal_cdf(z: Array) -> Array:
    """Return log Φ(z), the log probability of a standard normal value below z, shape as `z`."""
    result: Array = log_ndtr(np.clip(z, -LARGEST_Z, LARGEST_Z))
    return result


def log_student_t_pdf(residual: Array, scale: Array, degrees_of_freedom: float) -> Array:
    """Return the log density (n,) of Student's t distribution at residuals (n,).

    A residual is an observation minus the location. The scale (n,) > 0 is in its unit, and the
    number of degrees of freedom is ν > 0.
    """
    nu = degrees_of_freedom
    constant = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
    density: Array = (
        constant - np.log(scale) - 0.5 * (nu + 1.0) * np.log1p((residual / scale) ** 2 / nu)
    )
    return density


def log_h(z: Array) -> Array:
    """Return log h(z) (m,), h(z) = φ(z) + z Φ(z): expected improvement in standard deviations.

    With the Mills ratio m(a) = Φ(-a) / φ(a), h(-a) = φ(a) (1 - a m(a)), which is computed from the
    scaled complementary error function for moderate a, and from the asymptotic series
    1 - a m(a) = a⁻² - 3 a⁻⁴ + 15 a⁻⁶ - … for large a. It is finite for all finite z (m,).
    """
    z = np.clip(z, -LARGEST_Z, LARGEST_Z)
    a = np.maximum(-z, 1.0)
    near, far = np.minimum(a, SERIES_FROM), np.maximum(a, SERIES_FROM)
    closed = np.log1p(-SQRT_HALF_PI * near * erfcx(near / np.sqrt(2.0)))
    inverse = far**-2
    series = np.log1p(inverse * (-3.0 + 15.0 * inverse)) - 2.0 * np.log(far)
    below = log_normal_pdf(a) + np.where(a < SERIES_FROM, closed, series)
    upper = np.maximum(z, -1.0)
    above = np.log(np.exp(log_normal_pdf(upper)) + upper * np.exp(log_ndtr(upper)))
    return np.where(z < -1.0, below, above)


def log_expected_improvement(mean: Array, variance: Array, best: float) -> Array:
    """Return log E[max(best - f, 0)] (m,) for f ~ N(mean, variance): improvement is a lower value.

    The variance (m,) is in the squared unit of the mean (m,), and the improvement in that unit. It
    is -inf where the variance is zero, since a known value is not worth an evaluation.
    """
    known = variance <= 0.0
    sd = np.sqrt(np.where(known, 1.0, variance))
    with np.errstate(over="ignore"):  # log h stops an infinite z at LARGEST_Z
        z = (best - mean) / sd
    return np.where(known, -np.inf, np.log(sd) + log_h(z))
