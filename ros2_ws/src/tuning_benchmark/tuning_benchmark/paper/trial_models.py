"""Models of trials: each is one point, by its mean and its estimated worst case (paper, Sec. 4.1).

One process for the objective, one for each constrained response, and classifiers of failures and of
outliers. A failed trial is data for failures only.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bo_tuner.models.constraints import BELIEVED_FEASIBLE, LimitedResponse, log_feasibility
from bo_tuner.models.fitting import Fitting
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.protocol import FitModel, Model
from bo_tuner.models.scalarization import Chebyshev
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import OBJECTIVE, Constraint
from bo_tuner.study.limit_kinds.limited import Limited
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState
from tuning_benchmark.paper.constraints import JointConstraint, SurrogateConstraint
from tuning_benchmark.paper.single_evaluations import single_evaluation_worst_cases


class WorstCaseModel(Protocol):
    """Models a limit on the worst case."""

    def __call__(
        self, fitting: Fitting, fit: FitModel, trials: Sequence[Trial], worst: Constraint
    ) -> LimitedResponse:
        """Return the limit, with the model of its response.

        Parameters
        ----------
        fitting
            Has the points and observations, and collects the model.
        fit
            Fits the model of a response.
        trials
            Complete ones.
        worst
            The constraint.
        """


def of_estimates(
    fitting: Fitting, fit: FitModel, trials: Sequence[Trial], worst: Constraint
) -> SurrogateConstraint:
    """Model the worst cases that the search of each trial has estimated."""
    y = single_evaluation_worst_cases(trials, worst)
    model = fitting.model(fit, worst.name, fitting.points(trials), y, fitting.minimum)
    return SurrogateConstraint(model, worst.limit, worst.sign)


def over_contexts(
    fitting: Fitting, fit: FitModel, trials: Sequence[Trial], worst: Constraint
) -> JointConstraint:
    """Model the metric over parameter set and context, by all evaluations (Algorithm V)."""
    contexts = fitting.study.context_space()
    x, c, y = fitting.joint_observations(trials, worst.metric)
    minimum = np.append(fitting.minimum, np.zeros(contexts.dimension))
    exact = fitting.study.is_noiseless
    model = fitting.model(fit, worst.name, np.hstack([x, c]), y, minimum, exact=exact)
    margin = worst.sign * worst.deviations * model.noise_variance**0.5
    return JointConstraint(model, worst.limit - margin, worst.sign, contexts=contexts.candidates())


@dataclass(frozen=True)
class TrialModels:
    """Fits the models of trials; see `FitSurrogates`.

    Attributes
    ----------
    fit
        Fits the model of a response.
    reject_outliers
        Whether outliers of the objective are excluded from all models, and their region is avoided.
    worst_case
        Models a limit on the worst case.
    """

    fit: FitModel = GaussianProcess.fit
    reject_outliers: bool = True
    worst_case: WorstCaseModel = of_estimates

    def __call__(
        self,
        study: Study,
        trials: Sequence[Trial],
        *,
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]] | None = None,
        weights: Array | None = None,
        keep: bool = False,
    ) -> Surrogates:
        """Fit all models; see `FitSurrogates`."""
        fitting = Fitting(study, trials, rng, start, keep=keep)
        complete = [t for t in trials if t.state is TrialState.COMPLETE]
        rejecting = self.reject_outliers and bool(complete)
        outliers = fitting.outliers(complete) if rejecting else frozenset()
        # Trials with an outlying objective would distort the other models as well.
        kept = [t for t in complete if t.number not in outliers]
        objective: Model | None = None
        constraints: dict[str, LimitedResponse] = {}
        if complete and weights is None:
            objective = self._objective(fitting, kept)
            constraints = self._constraints(fitting, kept)
        elif complete and weights is not None:
            constraints = self._constraints(fitting, kept)
            objective = self._scalarized(fitting, kept, constraints.values(), weights)
        # A node that was lost may have died of its parameters.
        informative = [t for t in trials if not t.disturbed]
        failures = fitting.classifier(informative, lambda t: t.state is TrialState.FAILED)
        outlying = None
        if rejecting:
            outlying = fitting.classifier(complete, lambda t: t.number in outliers)
        return Surrogates(objective, constraints, failures, outlying, outliers, fitting.models)

    def _objective(self, fitting: Fitting, trials: Sequence[Trial]) -> Model:
        """Return the model of the cost, that of the first objective."""
        objective = fitting.study.objective
        x, y, _ = fitting.observations(trials, objective.metric)
        return fitting.model(self.fit, OBJECTIVE, x, objective.to_cost(y), fitting.minimum)

    def _scalarized(
        self,
        fitting: Fitting,
        trials: Sequence[Trial],
        constraints: Iterable[LimitedResponse],
        weights: Array,
    ) -> Model:
        """Return the model of the scalarization of k objectives with weights (k,)."""
        objectives = fitting.study.objectives
        costs = [
            np.column_stack([o.to_cost(t.observations(o.metric)) for o in objectives])
            for t in trials
        ]
        points = fitting.points(trials)
        feasible = log_feasibility(constraints, points) >= np.log(BELIEVED_FEASIBLE)
        means = np.array([values.mean(axis=0) for values in costs])
        chebyshev = Chebyshev.between(means, feasible, weights)
        x = np.repeat(points, [len(values) for values in costs], axis=0)
        y = np.concatenate([chebyshev.linearized(values) for values in costs])
        # Other weights than in the fit before make another response.
        return fitting.model(self.fit, OBJECTIVE, x, y, fitting.minimum, keep=False)

    def _constraints(self, fitting: Fitting, trials: Sequence[Trial]) -> dict[str, LimitedResponse]:
        """Return the limits, with the models of their responses, by name."""
        study, responses = fitting.study, _Responses(self, fitting, trials)
        ordered = (*study.drawn_constraints, *study.worst_case_constraints)
        return {constraint.name: constraint.rule.response(responses) for constraint in ordered}


@dataclass(frozen=True)
class _Responses:
    """What the models of trials can predict: `bo_tuner.study.limit_kinds.base.Responses`."""

    models: TrialModels
    fitting: Fitting
    trials: Sequence[Trial]

    def over_contexts(self, limited: Limited, level: float) -> LimitedResponse:
        """Model what was observed in the drawn contexts of each trial."""
        x, y, _ = self.fitting.observations(self.trials, limited.metric)
        minimum = self.fitting.minimum
        model = self.fitting.model(self.models.fit, limited.name, x, y, minimum)
        return SurrogateConstraint.on_observation(model, limited.limit, level, limited.sign)

    def in_every_context(self, limited: Limited, deviations: float) -> LimitedResponse:
        """Model the worst case."""
        worst = self.fitting.study.constraints[limited.name]
        return self.models.worst_case(self.fitting, self.models.fit, self.trials, worst)
