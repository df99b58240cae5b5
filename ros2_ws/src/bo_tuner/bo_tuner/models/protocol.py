"""Interface of the surrogate models.

Notation: n distinct points in d dimensions of the unit cube, m query points.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.models.compression import Compression
from bo_tuner.models.hyperpriors import Hyperpriors
from bo_tuner.numerics.arrays import Array


class Fitted(Protocol):
    """What a fit to observations leaves behind.

    Attributes
    ----------
    length_scales : ndarray, shape (d,)
        Distance along each axis within which the response changes little.
    warm_start : tuple of float
        Starting point for a later fit to similar data; recorded with the trial.
    warnings : tuple of str
        Numerical problems of the fit, one line each.
    """

    @property
    def length_scales(self) -> Array: ...  # noqa: D102

    @property
    def warm_start(self) -> tuple[float, ...]: ...  # noqa: D102

    @property
    def warnings(self) -> tuple[str, ...]: ...  # noqa: D102


class Model(Fitted, Protocol):
    """Posterior of a response over the unit cube.

    It predicts on the scale of `compression`; `predict_mean` alone is in the response's unit.

    Attributes
    ----------
    points : ndarray, shape (n, d)
        Distinct points at which the response was observed.
    counts : ndarray, shape (n,)
        Number of observations at each point.
    scale : float
        Spread of the responses, on the scale of predictions.
    noise_variance : float
        Variance of one observation's noise, on the scale of predictions.
    compression : Compression
        Map of responses to the scale of predictions.
    """

    @property
    def points(self) -> Array: ...  # noqa: D102

    @property
    def counts(self) -> Array: ...  # noqa: D102

    @property
    def scale(self) -> float: ...  # noqa: D102

    @property
    def noise_variance(self) -> float: ...  # noqa: D102

    @property
    def compression(self) -> Compression: ...  # noqa: D102

    def predict(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the latent response at x (m, d)."""

    def predict_mean(self, x: ArrayLike) -> Array:
        """Return the mean (m,) alone at x (m, d)."""

    def predict_reinterpolated(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the noise-free model; the variance is 0 at `points`."""


class FitModel(Protocol):
    """Fits a model to observations."""

    def __call__(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        rng: np.random.Generator,
        minimum_length_scales: ArrayLike | None = None,
        start: Sequence[float] | None = None,
        keep: bool = False,
        priors: Hyperpriors | None = None,
    ) -> Model:
        """Fit to points x (N, d), where equal rows are replicates, and responses y (N,).

        Parameters
        ----------
        x, y
            The observations.
        rng
            Source of random numbers.
        minimum_length_scales
            Lower bounds (d,) of the length scales.
        start
            `Model.warm_start` of an earlier fit.
        keep
            Whether `start` is good enough as it is, since little is new since that fit.
        priors
            Of the hyperparameters, if not the default ones.
        """
