"""The surrogates of stage one: what all trials so far say of every parameter set (Sec. 4.1).

One Gaussian process for the objective, one for each constrained response, and two
nearest-neighbour classifiers. A failed trial has no values; it speaks through the classifier of
failures alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bo_tuner.acquisition.acquisition import SurrogateConstraint
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.student_t import find_outliers
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.parts import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import EvaluationState, Trial, TrialState
from bo_tuner.worst_case.joint_search import JointConstraint, candidate_contexts

OBJECTIVE, OUTLIERS = "objective", "outliers"

# Distance in the unit cube within which a failure speaks for its neighbours. Not the objective's
# length scales: they come from complete trials only, and a flat response would stretch them.
CLASSIFIER_SCALE = 0.25
WarmStarts = dict[str, Hyperparameters]


@dataclass(frozen=True)
class ModelOptions:
    """Which models stand for the responses.

    Attributes
    ----------
    reject_outliers
        Whether outliers of the objective are kept out of all models, and their region is avoided.
    joint
        Model the worst case by one process over parameter set and context (Algorithm V) instead
        of by the estimates of the trials.
    """

    reject_outliers: bool = True
    joint: bool = False


DEFAULT_MODELS = ModelOptions()


@dataclass(frozen=True, eq=False)
class Surrogates:
    """Models of the cost and the constraints over the unit cube; build them by `fit`.

    Attributes
    ----------
    objective
        Model of the cost (the objective's metric, on its scale, to be minimised); None while no
        trial is complete.
    constraints
        One for each constraint of the study, in its order; empty while no trial is complete.
    classifiers
        Probabilities of a failure and, with the outlier scheme, of an outlier.
    outliers
        Numbers of the trials that were taken for outliers of the objective.
    hyperparameters
        Of each model by name, for the next warm start.
    warnings
        Numerical trouble of the fits.
    """

    objective: GaussianProcess | None
    constraints: tuple[SurrogateConstraint, ...]
    classifiers: tuple[NeighbourClassifier, ...]
    outliers: frozenset[int] = frozenset()
    hyperparameters: WarmStarts = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @classmethod
    def fit(
        cls,
        study: Study,
        trials: Sequence[Trial],
        *,
        rng: np.random.Generator,
        start: WarmStarts | None = None,
        options: ModelOptions = DEFAULT_MODELS,
    ) -> Self:
        """Fit to all trials.

        Parameters
        ----------
        study
            The study.
        trials
            All trials so far, failed ones too.
        rng
            Source of further starts of the hyperparameter searches.
        start
            Hyperparameters of an earlier fit.
        options
            Which models to fit.
        """
        space = study.search_space()
        minimum = space.minimum_length_scales()
        warm = start or {}
        complete = [t for t in trials if t.state is TrialState.COMPLETE]
        cube = {t.number: space.to_cube(_tuned(t, space.names)) for t in trials}
        models: dict[str, GaussianProcess] = {}

        def fit_model(name: str, x: Array, y: Array) -> GaussianProcess:
            models[name] = GaussianProcess.fit(
                x, y, rng=rng, minimum_length_scales=minimum, start=warm.get(name)
            )
            return models[name]

        outliers: frozenset[int] = frozenset()
        objective = None
        constraints: list[SurrogateConstraint] = []
        if complete:
            metric = study.objective.metric
            x, y, number = _observations(complete, cube, metric)
            if options.reject_outliers:
                # On the metric's own scale, where off-the-charts values stand out the most.
                mask, models[OUTLIERS] = find_outliers(
                    x,
                    study.objective.sign * y,
                    rng=rng,
                    minimum_length_scales=minimum,
                    start=warm.get(OUTLIERS),
                )
                outliers = frozenset(number[mask].tolist())
            # What has an outlying objective would mislead the other models as well.
            kept = [t for t in complete if t.number not in outliers]
            x, y, _ = _observations(kept, cube, metric)
            objective = fit_model(OBJECTIVE, x, study.objective.to_cost(y))
            for constraint in study.chance_constraints:
                x, y, _ = _observations(kept, cube, constraint.metric)
                model = fit_model(constraint.name, x, y)
                constraints.append(
                    SurrogateConstraint.on_observation(
                        model, constraint.upper, constraint.probability
                    )
                )
            worst = study.worst_case_constraint
            if worst is not None and options.joint:
                contexts = study.context_space()
                x, y = joint_observations(kept, cube, contexts, worst.metric)
                model = GaussianProcess.fit(
                    x,
                    y,
                    rng=rng,
                    minimum_length_scales=np.append(minimum, np.zeros(contexts.dimension)),
                    start=warm.get(worst.name),
                )
                models[worst.name] = model
                margin = worst.deviations * model.noise_variance**0.5
                constraints.append(
                    JointConstraint(model, worst.upper - margin, candidate_contexts(contexts))
                )
            elif worst is not None:
                x = np.array([cube[t.number] for t in kept])
                model = fit_model(worst.name, x, single_evaluation_worst_cases(kept, worst))
                constraints.append(SurrogateConstraint.on_expectation(model, worst.upper))
        x_all = np.array([cube[t.number] for t in trials]).reshape(-1, space.dimension)
        failed = np.array([t.state is TrialState.FAILED for t in trials], dtype=bool)
        scales = np.full(space.dimension, CLASSIFIER_SCALE)
        classifiers = [NeighbourClassifier(x_all, failed, scales)]
        if options.reject_outliers and complete:
            flagged = np.array([t.number in outliers for t in complete], dtype=bool)
            x_complete = np.array([cube[t.number] for t in complete])
            classifiers.append(NeighbourClassifier(x_complete, flagged, scales))
        return cls(
            objective=objective,
            constraints=tuple(constraints),
            classifiers=tuple(classifiers),
            outliers=outliers,
            hyperparameters={name: model.hyperparameters for name, model in models.items()},
            warnings=tuple(f"{name}: {w}" for name, m in models.items() for w in m.warnings),
        )

    def log_feasibility(self, x: Array) -> Array:
        """Log probability (m,) that a parameter set at x (m, d) meets all constraints."""
        total = np.zeros(len(x))
        for constraint in self.constraints:
            total += constraint.log_probability(x)
        return total


def joint_observations(
    trials: Sequence[Trial], cube: dict[int, Array], contexts: ContextSpace, metric: str
) -> tuple[Array, Array]:
    """Joint points (N, d + e) and values (N,) of all whole evaluations."""
    rows, values = [], []
    for trial in trials:
        for evaluation in trial.evaluations:
            if evaluation.outcome.state is EvaluationState.COMPLETE:
                context = [[evaluation.context[name] for name in contexts.names]]
                rows.append(np.append(cube[trial.number], contexts.to_cube(context)[0]))
                values.append(evaluation.outcome.metrics[metric])
    return np.array(rows), np.array(values)


def single_evaluation_worst_cases(trials: Sequence[Trial], constraint: Constraint) -> Array:
    """Return what an evaluation in the worst context of each trial reaches, shape (n,).

    It stays below with the constraint's probability. Trials without a worst case are left out.
    """
    worst = [t.worst_case.value for t in trials if t.worst_case is not None]
    return np.array(worst) + single_evaluation_margin(trials, constraint)


def single_evaluation_margin(trials: Sequence[Trial], constraint: Constraint) -> float:
    """Return the distance of a mean from the limit that a single cut's noise asks for.

    The noise is taken as equal everywhere: the few evaluations of one trial say little of it.
    """
    noise = [t.worst_case.noise for t in trials if t.worst_case is not None]
    return constraint.deviations * float(np.median(noise)) if noise else 0.0


def _tuned(trial: Trial, names: Sequence[str]) -> dict[str, int | float]:
    return {name: trial.parameters[name] for name in names}


def _observations(
    trials: Sequence[Trial], cube: dict[int, Array], metric: str
) -> tuple[Array, Array, NDArray[np.int_]]:
    """Points (N, d), values (N,) and trial numbers (N,) of the estimating evaluations."""
    x, y, number = [], [], []
    for trial in trials:
        for value in trial.observations(metric):
            x.append(cube[trial.number])
            y.append(value)
            number.append(trial.number)
    return np.array(x), np.array(y), np.array(number)
