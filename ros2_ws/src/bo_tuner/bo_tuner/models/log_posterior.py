"""Log marginal likelihood and maximum a posteriori of the Gaussian process's hyperparameters.

Notation: n distinct points with r_i observations each, N = Σ r_i; K the n × n prior covariance,
C = K + σ² diag(1 / r) = L Lᵀ, α = C⁻¹ ȳ; φ the log hyperparameters, shape (d + 2,).

References
----------
Rasmussen and Williams (2006). Gaussian Processes for Machine Learning. MIT Press.
Binois, Gramacy and Ludkovski (2018). Practical heteroscedastic Gaussian process modeling for
large simulation experiments. JCGS 27(4), Section 2: the likelihood of replicates.
"""

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from bo_tuner.models.hyperpriors import Hyperparameters, Hyperpriors
from bo_tuner.models.kernel import MEAN_SD, jittered_cholesky
from bo_tuner.models.replicates import Replicates
from bo_tuner.numerics.arrays import Array

# The Hessian of the log posterior is at least of order 1 / spread² in each φ, so the gradient
# bound leaves an error of some 0.01 in φ; a tighter one costs evaluations and changes no decision.
GRADIENT_TOLERANCE = 1e-2
MAXIMUM_ITERATIONS = 60
# With many points, one more hardly moves the optimum: a warm start is already close to it, and the
# next fit continues where this one stops.
WARM_ITERATIONS = 6
MANY_POINTS = 100
DRAWN_CHALLENGERS = 3


class LogPosterior:
    """Log marginal likelihood and log posterior of the log hyperparameters φ.

    Parameters
    ----------
    data : Replicates
        Standardized observations.
    priors : Hyperpriors
        Priors of φ.
    """

    def __init__(self, data: Replicates, priors: Hyperpriors) -> None:
        self.data = data
        self.priors = priors
        n = len(data.x)
        # Strictly lower triangle only, packed: half the exponentials and half the sums.
        row, column = np.tril_indices(n, -1)
        self._squared_distances = np.ascontiguousarray((data.x[row] - data.x[column]).T ** 2)
        self._lower = row + n * column  # positions in a column-major matrix
        self._diagonal = np.arange(n) * (n + 1)

    def covariance(self, parameters: Hyperparameters) -> tuple[Array, Array]:
        """Return C (n, n), and k (n (n - 1) / 2,) between all pairs of distinct points.

        C is column-major, with zeros above the diagonal; k is packed by rows.
        """
        n = len(self.data.x)
        variance = parameters.signal**2
        exponent = (-0.5 / parameters.length_scales**2) @ self._squared_distances
        kernel = np.exp(exponent, out=exponent)
        kernel *= variance
        flat = np.zeros(n * n)
        flat[self._lower] = kernel + MEAN_SD**2
        flat[self._diagonal] = variance + MEAN_SD**2 + parameters.noise**2 / self.data.count
        return flat.reshape((n, n), order="F"), kernel

    def log_marginal_likelihood(self, phi: Array) -> tuple[float, Array]:
        """Return the log density of all N standardized observations and its gradient (d + 2,) in φ.

        The gradient is ½ tr((α αᵀ - C⁻¹) ∂C/∂φ) (Rasmussen and Williams 2006, Eq. 5.9), plus
        the direct dependence of the replicate terms on σ².
        """
        data, parameters = self.data, Hyperparameters.from_log(phi)
        covariance, kernel = self.covariance(parameters)
        factor, _ = jittered_cholesky(covariance)
        alpha, _ = lapack.dpotrs(factor, data.mean, lower=1)
        value = log_likelihood(factor, alpha, data, parameters.noise)

        inverse, _ = lapack.dpotri(factor, lower=1)
        weight = np.outer(alpha, alpha) - inverse.T  # upper triangle of rows = lower of columns
        flat = weight.reshape(-1)
        pairs = flat[self._lower] * kernel
        diagonal = flat[self._diagonal]
        noise_variance = parameters.noise**2
        gradient = np.empty_like(phi)
        gradient[:-2] = (self._squared_distances @ pairs) / parameters.length_scales**2
        gradient[-2] = 2.0 * pairs.sum() + parameters.signal**2 * diagonal.sum()
        gradient[-1] = (
            noise_variance * (diagonal / data.count).sum()
            + data.sum_of_squares / noise_variance
            - (data.observations - len(data.x))
        )
        return value, gradient

    def value(self, phi: Array) -> float:
        """Return the log posterior without the normalizing constant of the data."""
        data, parameters = self.data, Hyperparameters.from_log(phi)
        factor, _ = jittered_cholesky(self.covariance(parameters)[0])
        alpha, _ = lapack.dpotrs(factor, data.mean, lower=1)
        likelihood = log_likelihood(factor, alpha, data, parameters.noise)
        return likelihood + self.priors.log_density(phi)[0]

    def value_and_gradient(self, phi: Array) -> tuple[float, Array]:
        """Return the value of `value` and its gradient (d + 2,) in φ."""
        likelihood, likelihood_gradient = self.log_marginal_likelihood(phi)
        prior, prior_gradient = self.priors.log_density(phi)
        return likelihood + prior, likelihood_gradient + prior_gradient


def log_likelihood(factor: Array, alpha: Array, data: Replicates, noise: float) -> float:
    """Return the log density of all N observations from their sufficient statistics.

    The N × N determinant and quadratic form reduce to the n × n ones of C and to terms of the
    within-group sum of squares (Binois et al. 2018, Section 2). `factor` is L, `alpha` α and
    `noise` σ, the standard deviation of one observation's noise.
    """
    surplus = data.observations - len(data.x)
    return float(
        -0.5 * data.mean @ alpha
        - np.log(np.diag(factor)).sum()
        - 0.5 * data.sum_of_squares / noise**2
        - surplus * np.log(noise)
        - 0.5 * np.log(data.count).sum()
        - 0.5 * data.observations * np.log(2.0 * np.pi)
    )


def maximize_posterior(
    posterior: LogPosterior,
    box: Array,
    rng: np.random.Generator,
    start: Array | None,
    *,
    restart: bool = False,
) -> tuple[Array, tuple[str, ...]]:
    """Find the maximum a posteriori of φ by L-BFGS-B.

    Without `start`, one run starts at the prior medians and one at short length scales and little
    noise (two spreads and one below their medians), because long length scales can lead to an
    optimum that explains the signal as noise. With `start`, one run starts there. A second one
    starts at the best of these two points and DRAWN_CHALLENGERS draws from the priors, if its log
    posterior exceeds that of `start`: the new data then contradict the earlier hyperparameters.
    With both `start` and `restart`, all three runs are made.

    Parameters
    ----------
    posterior : LogPosterior
    box : ndarray, shape (d + 2, 2)
        Bounds of φ.
    rng : numpy.random.Generator
        Draws the challengers.
    start : ndarray, shape (d + 2,), optional
        Warm start.
    restart : bool
        Whether the runs are made that a `start` makes unnecessary unless it leads to a local
        optimum.

    Returns
    -------
    phi : ndarray, shape (d + 2,)
        The best φ found; `start`, else the prior medians, where none has a finite posterior.
    warnings : tuple of str
    """
    lower, upper = box.T
    starts = _starts(posterior, box, rng, start, restart)

    def loss(phi: Array) -> tuple[float, Array]:
        value, gradient = posterior.value_and_gradient(phi)
        return -value, -gradient

    warm = start is not None and len(starts) == 1 and len(posterior.data.x) > MANY_POINTS
    best, best_value = starts[0], -np.inf
    for phi in starts:
        result = minimize(
            loss,
            phi,
            jac=True,
            method="L-BFGS-B",
            bounds=box,
            options={
                "gtol": GRADIENT_TOLERANCE,
                "ftol": 1e-9,
                "maxiter": WARM_ITERATIONS if warm else MAXIMUM_ITERATIONS,
            },
        )
        # Compares false for NaN, and the result of a failed line search is still a better φ.
        if -result.fun > best_value and np.isfinite(result.x).all():
            best, best_value = np.clip(result.x, lower, upper), -result.fun
    if np.isfinite(best_value):
        return best, ()
    origin = "the prior medians" if start is None else "the earlier hyperparameters"
    return starts[0], (f"hyperparameters: the log posterior is not finite, kept {origin}",)


def _starts(
    posterior: LogPosterior,
    box: Array,
    rng: np.random.Generator,
    start: Array | None,
    restart: bool,
) -> list[Array]:
    """Return where the runs of `maximize_posterior` start, shape (d + 2,) each."""
    dimension = len(box) - 2
    lower, upper = box.T
    priors = posterior.priors
    medians = priors.medians(dimension)
    short = medians - priors.spreads(dimension) * np.repeat([2.0, 0.0, 1.0], [dimension, 1, 1])
    starts = [np.clip(phi, lower, upper) for phi in (medians, short)]
    if start is None:
        return starts
    warm = np.clip(start, lower, upper)
    if restart:
        return [warm, *starts]
    draws = [priors.draw(dimension, rng) for _ in range(DRAWN_CHALLENGERS)]
    challengers = starts + [np.clip(phi, lower, upper) for phi in draws]
    values = [posterior.value(phi) for phi in challengers]
    best = int(np.argmax(values))
    return [warm, challengers[best]] if values[best] > posterior.value(warm) else [warm]
