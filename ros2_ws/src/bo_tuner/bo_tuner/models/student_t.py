"""Gaussian process with a Student-t likelihood, and outlier detection with it.

Model of the standardized replicate means ȳ_i at the n distinct points (paper, Section 3):

    ȳ_i = f(x_i) + ε_i,   ε_i ~ t_ν(0, s_i),   s_i² = (ν - 2) / ν · max(σ² / r_i, SCALE_FLOOR²),

with ν = 4. The scale is not a hyperparameter: the t distribution has the variance of the mean of
r_i observations of a reference Gaussian process, whose hyperparameters and standardization the
model shares. The reference is fitted to the bulk of the data, so that outliers do not affect it.

An outlier is judged by its residual at the mode of Ψ(f) = log p(ȳ | f) - ½ fᵀ K⁻¹ f, f being the
latent values.

Mode finding. The t likelihood is not log-concave: far from its centre the curvature is negative, Ψ
can have several maxima, and Newton's method may diverge. But t is a scale mixture of normals, and
the expectation-maximization algorithm over the mixing variables is iteratively reweighted least
squares, f ← K (K + W⁻¹)⁻¹ ȳ with W_i = (ν + 1) / (ν s_i² + (ȳ_i - f_i)²), of which every step
increases Ψ. A step of twice that length is tried as well, and taken only if it increases Ψ more; so
the iteration is monotone, and f is usable whether it ends by tolerance or by the iteration limit.
It starts at the mean of the reference, and so ends in the mode of that basin: the one at which the
model does not follow the outliers.

References
----------
Rasmussen and Williams (2006). Gaussian Processes for Machine Learning, Section 3.4.
Vanhatalo, Jylänki and Vehtari (2009). Gaussian process regression with Student-t likelihood.
NeurIPS 22.
Martinez-Cantin, Tee and McCourt (2018). Practical Bayesian optimization in the presence of
outliers. AISTATS 21.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack
from scipy.special import stdtr

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.kernel import jittered_cholesky, latent_covariance
from bo_tuner.models.replicates import Replicates, Standardization, checked_data
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_student_t_pdf

DEGREES_OF_FREEDOM = 4.0
# In standard deviations of the bulk. Small misfits of the model are not outliers, however exact the
# observations are.
SCALE_FLOOR = 0.05
# A parameter set is an outlier if a t variable exceeds its residual with at most this
# probability: 7.2 scales above the model for ν = 4.
TAIL_PROBABILITY = 1e-3
# Replicate means farther than this many robust standard deviations above the median are not in the
# bulk that the reference is fitted to; the Student-t process decides whether they are outliers.
BULK_WIDTH = 5.0
MAD_TO_SD = 1.4826
MAXIMUM_ITERATIONS = 100
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class StudentTProcess:
    """The Student-t process at the mode; build it by `fit`.

    Attributes
    ----------
    data : Replicates
        All observations, standardized; n distinct points.
    scale : ndarray, shape (n,)
        s_i, in standardized responses.
    mode : ndarray, shape (n,)
        Mode of the latent values, in standardized responses.
    """

    data: Replicates
    scale: Array
    mode: Array

    @classmethod
    def fit(cls, x: ArrayLike, y: ArrayLike, reference: GaussianProcess) -> Self:
        """Find the mode of the latent values of responses y (N,) at x (N, d) in the unit cube.

        Equal rows are replicates. The `reference` is fitted to the bulk of the data; the
        hyperparameters and the standardization are its.

        Raises
        ------
        ValueError
            If the data are invalid.
        """
        points, responses = checked_data(x, y)
        data = Replicates.group(points, reference.standardization.apply(responses))
        sd = np.maximum(reference.hyperparameters.noise / np.sqrt(data.count), SCALE_FLOOR)
        scale = sd * np.sqrt((DEGREES_OF_FREEDOM - 2.0) / DEGREES_OF_FREEDOM)
        start = reference.standardization.apply(reference.predict(data.x)[0])
        kernel = latent_covariance(reference.hyperparameters, data.x, data.x)
        return cls(data, scale, _find_mode(kernel, data.mean, scale, start))

    def outliers(self) -> NDArray[np.bool_]:
        """Mark the observations (N,) of outlying parameter sets; replicates of one share the mark.

        A parameter set is an outlier if its mean response lies so far above the model that its
        one-sided Student-t tail probability is at most `TAIL_PROBABILITY`. Values below the model
        are never outliers, since the response is minimized.
        """
        z = (self.data.mean - self.mode) / self.scale
        mask: NDArray[np.bool_] = stdtr(DEGREES_OF_FREEDOM, -z) <= TAIL_PROBABILITY
        return mask[self.data.index]


def _find_mode(kernel: Array, y: Array, scale: Array, start: Array) -> Array:
    """Maximize Ψ(f) over f = K a, shape (n,), by guarded over-relaxed reweighted least squares.

    The iteration runs over a = K⁻¹ f, with which fᵀ K⁻¹ f needs no inverse of K.
    """
    nu = DEGREES_OF_FREEDOM

    def psi(a: Array, f: Array) -> float:
        return float(log_student_t_pdf(y - f, scale, nu).sum() - 0.5 * a @ f)

    def reweighted(f: Array) -> Array:
        """One step: a = (K + W⁻¹)⁻¹ y."""
        weighted = kernel.copy()
        weighted[np.diag_indices(len(y))] += (nu * scale**2 + (y - f) ** 2) / (nu + 1.0)
        factor, _ = jittered_cholesky(weighted)
        result: Array = lapack.dpotrs(factor, y, lower=1)[0]
        return result

    # The start need not lie in the range of K; after one step f = K a does.
    a = reweighted(start)
    f = kernel @ a
    value = psi(a, f)
    for _ in range(MAXIMUM_ITERATIONS):
        step = reweighted(f) - a
        candidates = [a + step, a + 2.0 * step]
        latents = [kernel @ candidate for candidate in candidates]
        values = [psi(*pair) for pair in zip(candidates, latents, strict=True)]
        best = int(np.argmax(values))
        if not values[best] - value > TOLERANCE:
            break
        a, f, value = candidates[best], latents[best], values[best]
    return f


def find_outliers(
    x: ArrayLike,
    y: ArrayLike,
    *,
    rng: np.random.Generator,
    minimum_length_scales: ArrayLike | None = None,
    start: Sequence[float] | None = None,
    keep: bool = False,
) -> tuple[NDArray[np.bool_], GaussianProcess]:
    """Mark the outliers among all observations (paper, Section 3).

    A reference is fitted to the bulk of the data, and the Student-t process of all data with its
    hyperparameters marks the outliers. Each call determines the bulk from medians, independently
    of earlier results, so no point is excluded permanently. The scheme fails if half of the
    parameter sets are outliers.

    Parameters
    ----------
    x, y, rng, minimum_length_scales, start, keep
        As `GaussianProcess.fit`.

    Returns
    -------
    outliers : ndarray of bool, shape (N,)
        Mark of each observation; replicates of one point share it.
    reference : GaussianProcess
        Fitted to the bulk.

    Raises
    ------
    ValueError
        As `GaussianProcess.fit`.
    """
    points, responses = checked_data(x, y)
    bulk = _bulk(points, responses)
    reference = GaussianProcess.fit(
        points[bulk],
        responses[bulk],
        rng=rng,
        minimum_length_scales=minimum_length_scales,
        start=start,
        keep=keep,
    )
    return StudentTProcess.fit(points, responses, reference).outliers(), reference


def _bulk(x: Array, y: Array) -> NDArray[np.bool_]:
    """Mark the observations of points with a mean not far above the median, shape (N,)."""
    data = Replicates.group(x, Standardization.of(y).apply(y))
    above = data.mean - np.median(data.mean)
    width = BULK_WIDTH * MAD_TO_SD * np.median(np.abs(above))
    if width == 0.0:  # half of the means are equal, a response at its limit; the rest may vary
        width = BULK_WIDTH * MAD_TO_SD * np.abs(above).mean()
    near: NDArray[np.bool_] = above <= width
    return near[data.index]
