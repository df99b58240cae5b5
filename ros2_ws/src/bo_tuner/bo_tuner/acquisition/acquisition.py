"""Acquisition functions of the paper (Eq. 5), as sums of logarithms.

    log α(x) = log RI(x) + log p_feas(x) + log(1 - p_out(x)) + log(1 - p_fail(x))

RI is the expected improvement under the reinterpolation model of the objective (Forrester et al.
2006), p_feas the product of the probabilities of feasibility, the constraints taken as independent;
p_out and p_fail come from the nearest-neighbour classifiers. The logarithm preserves the order of
points where α underflows.

Each factor is a function, and `Acquisition` adds their logarithms: another acquisition function has
another improvement, or other probabilities.

Notation: d tuned parameters, m query points in the unit cube.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.protocol import Model
from bo_tuner.models.surrogates import Classifier, Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement

OUTLYING = 0.5
"""Probability of an outlier up to which no point is excluded."""


LEAST_BELIEF = 1e-12
"""Least density of a prior, as a share of the largest."""


Factor = Callable[[Array], Array]
"""Logarithm (m,) of a factor at points (m, d) of the unit cube; -inf excludes a point."""


@dataclass(frozen=True, eq=False)
class Acquisition:
    """An acquisition function, as the sum of the logarithms of its factors, to be maximized.

    Attributes
    ----------
    improvement
        What is worth a trial, on any scale; None for the probabilities alone.
    probabilities
        Logarithms of probabilities, none above 0: the sooner one that costs little, the better.
    expected
        Whether the improvement is the logarithm of the one that is expected, in the unit of the
        cost. Then a small one is no longer worth a trial, and the advice to stop is by it.
    prior
        Logarithm, none above 0, of what is believed beforehand; it counts for the order of points,
        not for what is worth a trial.
    """

    improvement: Factor | None
    probabilities: tuple[Factor, ...] = ()
    expected: bool = True
    prior: Factor | None = None

    def __call__(self, x: Array) -> Array:
        """Return the sum of all logarithms (m,) at x (m, d)."""
        return self.where_above(np.full(len(x), -np.inf), x)

    def where_above(self, least: Array, x: Array) -> Array:
        """Return the sum (m,) at x (m, d) where it exceeds `least` (m,), and else -inf.

        A probability can only lower the sum, so where that is no larger than `least` any more, the
        further ones are not asked for.
        """
        total = np.zeros(len(x))
        if self.improvement is not None:
            total += self.improvement(x)
        first = () if self.prior is None else (self.prior,)
        for probability in (*first, *self.probabilities):
            rows = np.flatnonzero(total > least)
            if not len(rows):
                break
            total[rows] += probability(x[rows])
        return np.where(total > least, total, -np.inf)


class AcquisitionRule(Protocol):
    """Makes an acquisition function from the surrogates."""

    def __call__(
        self,
        surrogates: Surrogates,
        incumbent: float | None,
        *,
        avoid: float,
        reinterpolate: bool,
    ) -> Acquisition:
        """Make the acquisition function.

        Parameters
        ----------
        surrogates
            Models of all trials.
        incumbent
            Cost to improve on; None while no parameter set is believed feasible.
        avoid
            Largest probability of a failure.
        reinterpolate
            Whether the improvement is under the reinterpolation model.
        """


@dataclass(frozen=True, eq=False)
class WithPrior:
    """An acquisition function times what is believed beforehand, to a power: πBO.

        α(x) π(x)^(β / n)

    Hvarfner et al. (2022, ICLR, Eq. 6); a small number is added to π, as SMAC does.

    Attributes
    ----------
    rule
        Makes α.
    log_prior
        Logarithm of π, none above 0.
    exponent
        β / n.
    """

    rule: AcquisitionRule
    log_prior: Factor
    exponent: float

    def __call__(
        self,
        surrogates: Surrogates,
        incumbent: float | None,
        *,
        avoid: float,
        reinterpolate: bool,
    ) -> Acquisition:
        """Make the acquisition function."""
        made = self.rule(surrogates, incumbent, avoid=avoid, reinterpolate=reinterpolate)
        return replace(made, prior=self._weighted)

    def _weighted(self, x: Array) -> Array:
        return self.exponent * np.maximum(self.log_prior(x), np.log(LEAST_BELIEF))


@dataclass(frozen=True, eq=False)
class LogImprovement:
    """Log expected improvement on `best` by the means and variances that a model predicts.

    Under the reinterpolation model (Eq. 5), it is -inf at the data; under the noisy one it is also
    finite there.
    """

    predict: Callable[[Array], tuple[Array, Array]]
    best: float

    def __call__(self, x: Array) -> Array:
        """Return the log improvement (m,) at x (m, d)."""
        mean, variance = self.predict(x)
        return log_expected_improvement(mean, variance, self.best)


@dataclass(frozen=True, eq=False)
class Unevaluated:
    """-inf at the points of the model's data, 0 elsewhere."""

    model: Model

    def __call__(self, x: Array) -> Array:
        """Return 0 or -inf (m,) at x (m, d)."""
        _, variance = self.model.predict_reinterpolated(x)
        return np.where(variance <= 0.0, -np.inf, 0.0)


@dataclass(frozen=True, eq=False)
class LogAvoidance:
    """Log(1 - p) of a classifier's probability p, and -inf where p exceeds `avoid`.

    The product of Eq. 5 alone does not keep the search away from failures: the objective remains
    uncertain there, while the reinterpolation improvement elsewhere tends to zero.
    """

    classifier: Classifier
    avoid: float

    def __call__(self, x: Array) -> Array:
        """Return log(1 - p) or -inf (m,) at x (m, d)."""
        log_complement = self.classifier.log_complement(x)
        least = np.log1p(-self.avoid) if self.avoid < 1.0 else -np.inf
        return np.where(log_complement < least, -np.inf, log_complement)


def constrained_improvement(
    surrogates: Surrogates,
    incumbent: float | None,
    *,
    avoid: float,
    reinterpolate: bool,
) -> Acquisition:
    """Make the acquisition function of Eq. 5.

    Parameters
    ----------
    surrogates
        Models of all trials.
    incumbent
        Cost to improve on, on the scale of the model's predictions: the lowest posterior mean among
        the points believed feasible. If None, the function has no improvement term and excludes
        evaluated points.
    avoid
        Largest probability of a failure; points above it are excluded, and those where an outlier
        is more probable than `OUTLYING`. With 1.0 none is.
    reinterpolate
        Use the improvement under the reinterpolation model; else the one under the noisy model,
        with evaluated points excluded.
    """
    improvement: Factor | None = None
    probabilities: list[Factor] = []
    model = surrogates.objective
    if model is not None and incumbent is not None and reinterpolate:
        improvement = LogImprovement(model.predict_reinterpolated, incumbent)
    elif model is not None:
        if incumbent is not None:
            improvement = LogImprovement(model.predict, incumbent)
        probabilities.append(Unevaluated(model))
    # Without a single outlier or failure there is nothing to avoid. An outlier costs no more than
    # its evaluations, so how many failures are allowed says nothing of it.
    outlying = OUTLYING if avoid < 1.0 else 1.0
    levels = ((surrogates.failures, avoid), (surrogates.outlying, outlying))
    probabilities += [
        LogAvoidance(c, level) for c, level in levels if c is not None and c.labels.any()
    ]
    # Chance limits are the first of a study, and need many contexts for each point.
    constraints = reversed(tuple(surrogates.constraints.values()))
    probabilities += [constraint.log_probability for constraint in constraints]
    return Acquisition(improvement, tuple(probabilities))


def best_at_data(model: Model, feasible: NDArray[np.bool_]) -> float | None:
    """Return the lowest posterior mean among the feasible points of a model's data.

    Expected improvement needs an incumbent without noise; the reinterpolation model interpolates
    the posterior means.

    Parameters
    ----------
    model : Model
        Surrogate of the objective, with n distinct points.
    feasible : ndarray of bool, shape (n,)
        Whether each row of `model.points` is believed feasible.

    Returns
    -------
    float or None
        On the scale of the model's predictions; None if no point is feasible.
    """
    if not feasible.any():
        return None
    lowest = model.predict_mean(model.points[feasible]).min()
    return float(model.compression.apply(lowest))
