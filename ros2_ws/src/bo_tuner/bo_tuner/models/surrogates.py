"""The surrogates of stage one, fitted to all trials (Sec. 4.1).

One process for the objective, one for each constrained response, and classifiers of failures and
of outliers. A failed trial tells of failures; where all evaluations are pooled, those of it that
are complete tell of the responses, too, and not to fail is one more limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from bo_tuner.models.constraints import LimitedResponse, log_feasibility
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.fitting import (
    DEFAULT_MODELS,
    Fitting,
    ModelOptions,
    fitted_after,
)
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.protocol import Fitted, Model
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import FAILURES
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState, pooled

Classifier = NeighbourClassifier | CrashModel


@dataclass(frozen=True, eq=False)
class Surrogates:
    """Models of the cost and the constraints over the unit cube; build them by `fit`.

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
    """

    objective: Model | None
    constraints: Mapping[str, LimitedResponse]
    failures: Classifier | None = None
    outlying: NeighbourClassifier | None = None
    outliers: frozenset[int] = frozenset()
    models: Mapping[str, Fitted] = field(default_factory=dict)

    @property
    def warm_starts(self) -> dict[str, tuple[float, ...]]:
        """Starting points for the next fit, by model name."""
        found = {name: model.warm_start for name, model in self.models.items()}
        if isinstance(self.failures, CrashModel) and self.failures.warm_start is not None:
            found[FAILURES] = self.failures.warm_start
        return found

    @property
    def warnings(self) -> tuple[str, ...]:
        """Numerical problems of the fits, each with the name of its model."""
        return tuple(f"{name}: {w}" for name, model in self.models.items() for w in model.warnings)

    @classmethod
    def fit(
        cls,
        study: Study,
        trials: Sequence[Trial],
        *,
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]] | None = None,
        options: ModelOptions = DEFAULT_MODELS,
        weights: Array | None = None,
    ) -> Self:
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
            `warm_starts` of an earlier fit; kept as they are unless it is time for a new fit, see
            `fitted_after`.
        options
            Which models to fit.
        weights : ndarray, shape (k,), optional
            The cost is the scalarization of the study's k objectives with these weights, without a
            unit. Without them it is that of the first objective alone.
        """
        if options.pooled:
            trials = pooled(trials)
        keep = not fitted_after(len(trials))
        fitting = Fitting(study, rng, start or {}, options, keep)
        complete = [t for t in trials if t.state is TrialState.COMPLETE]
        outliers: frozenset[int] = frozenset()
        objective = None
        constraints: dict[str, LimitedResponse] = {}
        if complete:
            if options.reject_outliers:
                outliers = fitting.outliers(complete)
            # Trials with an outlying objective would distort the other models as well.
            kept = [t for t in complete if t.number not in outliers]
            if options.pooled:
                # A failed trial's complete evaluations tell of the contexts that they were in.
                kept = [t for t in trials if t.number not in outliers]
            if weights is None:
                objective = fitting.objective(kept)
                constraints = fitting.constraints(kept)
            else:
                constraints = fitting.constraints(kept)
                objective = fitting.scalarized(kept, constraints.values(), weights)
        failures: Classifier
        if options.pooled:
            failures = fitting.crashes(trials)
        else:
            # A node that was lost may have died of its parameters.
            telling = [t for t in trials if not t.disturbed]
            failures = fitting.classifier(telling, lambda t: t.state is TrialState.FAILED)
        outlying = None
        if options.reject_outliers and complete:
            outlying = fitting.classifier(complete, lambda t: t.number in outliers)
        return cls(
            objective=objective,
            constraints=constraints,
            failures=failures,
            outlying=outlying,
            outliers=outliers,
            models=fitting.models,
        )

    def log_feasibility(self, x: Array) -> Array:
        """Return the log probability (m,) that all constraints hold at x (m, d)."""
        return log_feasibility(self.constraints.values(), x)

    def feasibility(self, x: Array) -> Array:
        """Return the probability (m,) that counts: by which x (m, d) are ranked as feasible."""
        pooled = isinstance(self.failures, CrashModel)
        return np.exp(self.log_confidence(x) if pooled else self.log_feasibility(x))

    def log_confidence(self, x: Array) -> Array:
        """Return `log_feasibility` in the most doubtful context of each limit, without failures."""
        total = np.zeros(len(x))
        for constraint in self.limits:
            total += constraint.least_log_probability(x)
        return total

    @property
    def limits(self) -> tuple[LimitedResponse, ...]:
        """The constraints, and the one on failures where it is modelled as such."""
        limits = tuple(self.constraints.values())
        if isinstance(self.failures, CrashModel) and self.failures.constraint is not None:
            limits += (self.failures.constraint,)
        return limits

    @property
    def classifiers(self) -> tuple[Classifier, ...]:
        """The probabilities of a failure and of an outlier, as far as they are modelled."""
        return tuple(c for c in (self.failures, self.outlying) if c is not None)
