"""Acquisition function of the paper (Eq. 5), as a sum of logarithms.

    log α(x) = log RI(x) + log p_feas(x) + log(1 - p_out(x)) + log(1 - p_fail(x))

RI is the expected improvement under the reinterpolation model of the objective (Forrester et al.
2006), p_feas the product of the probabilities of feasibility of independent constraints, p_out and
p_fail come from the nearest-neighbour classifiers. The logarithm keeps the order of points whose
plain α underflows.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement, log_normal_cdf


@dataclass(frozen=True, eq=False)
class SurrogateConstraint:
    """Upper limit on a response, judged by its Gaussian process; build it by a class method.

    Attributes
    ----------
    model : GaussianProcess
        Surrogate of the response.
    limit : float
        Upper limit of the latent response, in its unit.
    """

    model: GaussianProcess
    limit: float

    @classmethod
    def on_expectation(cls, model: GaussianProcess, limit: float) -> Self:
        """Constrain the latent response itself: f(x) ≤ limit.

        For a response whose noise is no property of the parameter set, such as the worst case
        over contexts estimated from noisy evaluations: the noise of the estimate must not count.

        Parameters
        ----------
        model : GaussianProcess
        limit : float
            In the unit of the response.
        """
        return cls(model, limit)

    @classmethod
    def on_observation(cls, model: GaussianProcess, limit: float, probability: float) -> Self:
        """Constrain single observations: P[y(x) ≤ limit] ≥ probability (paper, Eq. 3e).

        With y = f(x) + ε and ε ~ N(0, σ²) the constraint holds if and only if
        f(x) + z σ ≤ limit, z = Φ⁻¹(probability). So the predictive noise enters through the limit,
        and what stays uncertain is f(x).

        Parameters
        ----------
        model : GaussianProcess
        limit : float
            In the unit of the response.
        probability : float
            In (0, 1).

        Raises
        ------
        ValueError
            If `probability` is not in (0, 1).
        """
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability: expected a value in (0, 1), found {probability}")
        z = float(ndtri(probability))
        return cls(model, limit - z * model.noise_variance**0.5)

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Mean and variance of the constrained latent response, each of shape (m,)."""
        return self.model.predict(x)

    def log_probability(self, x: Array) -> Array:
        """Return the log probability that the constraint holds.

        Parameters
        ----------
        x : ndarray, shape (m, d)

        Returns
        -------
        ndarray, shape (m,)
        """
        mean, variance = self.predict(x)
        # Rounding can leave no variance at all; then the answer is yes or no, but still finite.
        sd = np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        with np.errstate(over="ignore"):  # log Φ stops an infinite argument
            return log_normal_cdf((self.limit - mean) / sd)


@dataclass(frozen=True, eq=False)
class LogAcquisition:
    """Log acquisition function, to be maximised.

    Attributes
    ----------
    objective : GaussianProcess or None
        Surrogate of the objective, which is minimised; None while there is no observation of it.
    best : float or None
        Objective to improve on, in the unit of the response: the lowest posterior mean among the
        points believed feasible. None while there is none: then feasibility is sought, so RI is
        left out, except that evaluated points stay excluded.
    constraints : tuple of SurrogateConstraint
    classifiers : tuple of NeighbourClassifier
        Estimates of p_out and p_fail.
    avoid : float
        Points of which a classifier is surer than this are left out. The product of Eq. 5 alone
        does not keep a search away from crashes: there the objective stays unknown, while the
        reinterpolated improvement elsewhere falls without bound.
    reinterpolate : bool
        Whether the improvement is the one under the reinterpolation model. If not, it is the one
        under the noisy model, which stays uncertain around its data, the evaluated points
        excepted.
    """

    objective: GaussianProcess | None
    best: float | None
    constraints: tuple[SurrogateConstraint, ...] = ()
    classifiers: tuple[NeighbourClassifier, ...] = ()
    avoid: float = 0.5
    reinterpolate: bool = True

    def __call__(self, x: Array) -> Array:
        """Return log α(x).

        Parameters
        ----------
        x : ndarray, shape (m, d)
            Points in the unit cube.

        Returns
        -------
        ndarray, shape (m,)
            -inf at points of which the objective was observed, and at and near outliers and
            crashes, see `avoid`.
        """
        total = np.zeros(len(x))
        if self.objective is not None:
            mean, variance = self.objective.predict_reinterpolated(x)
            evaluated = variance <= 0.0
            if self.best is not None:
                if not self.reinterpolate:
                    mean, variance = self.objective.predict(x)
                total += log_expected_improvement(mean, variance, self.best)
            total[evaluated] = -np.inf
        for constraint in self.constraints:
            total += constraint.log_probability(x)
        avoided = np.log1p(-self.avoid) if self.avoid < 1.0 else -np.inf
        for classifier in self.classifiers:
            log_complement = classifier.log_complement(x)
            total += np.where(log_complement < avoided, -np.inf, log_complement)
        return total


def best_at_data(model: GaussianProcess, feasible: NDArray[np.bool_]) -> float | None:
    """Return the lowest posterior mean among the feasible points of a model's data.

    Expected improvement under noise needs a noise-free incumbent: the interpolated values of the
    reinterpolation model are the posterior means.

    Parameters
    ----------
    model : GaussianProcess
        Surrogate of the objective, with n distinct points.
    feasible : ndarray of bool, shape (n,)
        Whether each row of `model.data.x` is believed feasible.

    Returns
    -------
    float or None
        In the unit of the response; None if no point is feasible.
    """
    if not feasible.any():
        return None
    return float(model.predict(model.data.x[feasible])[0].min())
