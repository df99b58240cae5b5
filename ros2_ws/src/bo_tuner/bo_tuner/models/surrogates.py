"""What a method models of parameter sets: objective, limits, failures, outliers (Sec. 4.1).

`pooled_models` makes them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.constraints import LimitedResponse, log_feasibility
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.protocol import Fitted, Model
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


class Classifier(Protocol):
    """Probability of an event, such as a failure, over the unit cube.

    Attributes
    ----------
    labels : ndarray of bool, shape (N,)
        Where the event was observed.
    """

    @property
    def labels(self) -> NDArray[np.bool_]: ...  # noqa: D102

    def probability(self, x: Array) -> Array:
        """Return the probability (m,) of the event at x (m, d)."""

    def log_complement(self, x: Array) -> Array:
        """Return the log probability (m,) that it does not occur at x (m, d)."""


@dataclass(frozen=True, eq=False)
class Surrogates:
    """Models of the cost and the constraints over the unit cube.

    Attributes
    ----------
    objective
        Model of the cost (the objective's metric on its scale, to be minimized); None while no
        trial is complete.
    constraints
        Constraints by their names in the study; empty while no trial is complete.
    failures
        Probability of a failure; None if nothing is known of it.
    outlying
        Probability of an outlier of the objective; None without the outlier scheme.
    outliers
        Numbers of the trials that are outliers of the objective.
    models
        Every model by its name: that of the objective, of the outlier scheme, and of each
        constraint.
    costs
        Models of the costs by the metrics of the objectives, as far as each has one of its own.
    """

    objective: Model | None
    constraints: Mapping[str, LimitedResponse]
    failures: Classifier | None = None
    outlying: NeighbourClassifier | None = None
    outliers: frozenset[int] = frozenset()
    models: Mapping[str, Fitted] = field(default_factory=dict)
    costs: Mapping[str, Model] = field(default_factory=dict)

    @property
    def warm_starts(self) -> dict[str, tuple[float, ...]]:
        """Starting points for the next fit, by model name."""
        return {name: model.warm_start for name, model in self.models.items()}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Numerical problems of the fits, each with the name of its model."""
        return tuple(f"{name}: {w}" for name, model in self.models.items() for w in model.warnings)

    def log_feasibility(self, x: Array) -> Array:
        """Return the log probability (m,) that all constraints hold at x (m, d)."""
        return log_feasibility(self.constraints.values(), x)

    def feasibility(self, x: Array) -> Array:
        """Return the probability (m,) that counts: by which x (m, d) are ranked as feasible."""
        return np.exp(self.log_confidence(x))

    def log_confidence(self, x: Array) -> Array:
        """Return `log_feasibility` in the most doubtful context of each limit, without failures."""
        total = np.zeros(len(x))
        for constraint in self.limits:
            total += constraint.least_log_probability(x)
        return total

    @property
    def limits(self) -> tuple[LimitedResponse, ...]:
        """The constraints, and any further limit that is modelled as one."""
        return tuple(self.constraints.values())

    @property
    def classifiers(self) -> tuple[Classifier, ...]:
        """The probabilities of a failure and of an outlier, as far as they are modelled."""
        return tuple(c for c in (self.failures, self.outlying) if c is not None)


S_co = TypeVar("S_co", bound=Surrogates, covariant=True)


class FitSurrogates(Protocol[S_co]):
    """Fits the surrogates of a study to its trials."""

    def __call__(
        self,
        study: Study,
        trials: Sequence[Trial],
        *,
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]] | None = None,
        weights: Array | None = None,
        keep: bool = False,
    ) -> S_co:
        """Fit all models.

        Parameters
        ----------
        study
            The study.
        trials
            All trials so far, failed ones included.
        rng
            Draws starting points of the hyperparameter fits.
        start
            `Surrogates.warm_starts` of an earlier fit; kept as they are unless it is time for a new
            fit, see `fitting.fitted_after`.
        weights : ndarray, shape (k,), optional
            The cost is the scalarization of the study's k objectives with these weights, without a
            unit. Without them it is that of the first objective alone.
        keep
            Keep the hyperparameters of `start` in any case.
        """
