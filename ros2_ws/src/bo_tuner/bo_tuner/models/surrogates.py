"""The surrogates of stage one, fitted to all trials (Sec. 4.1).

One Gaussian process for the objective, one for each constrained response, and two
nearest-neighbour classifiers. A failed trial has no values; only the classifier of failures uses
it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding, coded, coded_fit
from bo_tuner.models.constraints import JointConstraint, LimitedResponse, SurrogateConstraint
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.joint_process import JointProcess
from bo_tuner.models.joint_responses import EveryContext, ExpectedObjective, OverContexts
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.observations import (
    joint_observations,
    searched_contexts,
    single_evaluation_worst_cases,
)
from bo_tuner.models.protocol import FitModel, Fitted, Model
from bo_tuner.models.scalarization import Chebyshev
from bo_tuner.models.student_t import find_outliers
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parts import Constraint, Objective
from bo_tuner.study.study import Study
from bo_tuner.trials import EvaluationState, Trial, TrialState, pooled

OBJECTIVE, OUTLIERS, FAILURES = "objective", "outliers", "failures"

BELIEVED_FEASIBLE = 0.5
"""Lowest probability of feasibility of a parameter set that counts as feasible."""

CONFIDENT = 0.975
"""Lowest probability of feasibility of the answer of an algorithm with pooled evaluations."""

# Length scale of the classifiers in the unit cube. The objective's length scales do not suit them:
# they are fitted to complete trials only, and are long if the response is flat.
CLASSIFIER_SCALE = 0.25

EXPECTED_OVER = 256
"""Number of contexts, the same in every fit, that an expectation is taken over."""

CHANCE_OVER = 64
"""Number of contexts, the same in every fit, that the probability of a chance limit is over."""

FITTED_EACH = 100
"""Number of trials up to which the hyperparameters are fitted anew after each of them."""

GROWTH = 0.05
"""Part by which the number of trials grows between fits of the hyperparameters after that.

A fit is most of the time of a suggestion then, and one of many trials changes it little. So the
number of fits grows with the logarithm of the trials.
"""

Classifier = NeighbourClassifier | CrashModel


@dataclass(frozen=True)
class ModelOptions:
    """Which surrogate models to fit.

    Attributes
    ----------
    reject_outliers
        Whether outliers of the objective are excluded from all models, and their region is avoided.
    joint
        Model the constrained metric by one process over parameter set and context (Algorithm V)
        instead of the worst cases estimated in the trials.
    pooled
        Model objective and constrained metric by processes over parameter set and context with
        local noise, to which all evaluations contribute; failed runs likewise.
    fit
        Fits the model of a response; by default a Gaussian process.
    """

    reject_outliers: bool = True
    joint: bool = False
    pooled: bool = False
    fit: FitModel = GaussianProcess.fit


DEFAULT_MODELS = ModelOptions()


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
        fitting = _Fitting(study, rng, start or {}, options, keep)
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
            failures = fitting.classifier(trials, lambda t: t.state is TrialState.FAILED)
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
        return _log_feasibility(self.constraints.values(), x)

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


def fitted_after(trials: int) -> bool:
    """Return whether hyperparameters are fitted after so many trials, or those before are kept."""
    if trials <= FITTED_EACH:
        return True
    now, before = (np.log(n / FITTED_EACH) // np.log1p(GROWTH) for n in (trials, trials - 1))
    return bool(now > before)


def _log_feasibility(constraints: Iterable[LimitedResponse], x: Array) -> Array:
    """Return the log probability (m,) that all constraints hold at x (m, d)."""
    total = np.zeros(len(x))
    for constraint in constraints:
        total += constraint.log_probability(x)
    return total


class _Fitting:
    """Fits the models of one study to trials, and collects them."""

    def __init__(
        self,
        study: Study,
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]],
        options: ModelOptions,
        keep: bool,
    ) -> None:
        self._study = study
        self._space = study.search_space()
        self._minimum = self._space.minimum_length_scales()
        self._coding = Coding(self._space.levels)
        self._rng = rng
        self._start = start
        self._options = options
        self._keep = keep
        self._cubes: dict[int, Array] = {}
        self.models: dict[str, Fitted] = {}

    def outliers(self, complete: Sequence[Trial]) -> frozenset[int]:
        found = self._outliers(complete, self._study.objective, OUTLIERS)
        for further in self._study.further_objectives:
            found |= self._outliers(complete, further, f"{OUTLIERS}_{further.metric}")
        return found

    def _outliers(
        self, complete: Sequence[Trial], objective: Objective, name: str
    ) -> frozenset[int]:
        x, y, number = self._observations(complete, objective.metric)
        # On the metric's own scale, where off-the-charts values stand out the most.
        mask, bulk = find_outliers(
            self._coding.encode(x),
            objective.sign * y,
            rng=self._rng,
            minimum_length_scales=self._coding.spread(self._minimum),
            start=self._start.get(name),
            keep=self._keep,
        )
        self.models[name] = coded(bulk, self._coding)
        return frozenset(number[mask].tolist())

    def objective(self, trials: Sequence[Trial]) -> Model:
        if self._options.pooled:
            metric, contexts = self._study.objective.metric, self._study.context_space()
            process = self._process(OBJECTIVE, trials, metric, self._study.objective.to_cost)
            drawn = contexts.draw_stratified(EXPECTED_OVER, np.random.default_rng(0))
            return ExpectedObjective(process, contexts.to_cube(drawn), self._study.objective)
        x, y, _ = self._observations(trials, self._study.objective.metric)
        return self._fit(OBJECTIVE, x, self._study.objective.to_cost(y), self._minimum)

    def scalarized(
        self, trials: Sequence[Trial], constraints: Iterable[LimitedResponse], weights: Array
    ) -> Model:
        costs = [
            np.column_stack([o.to_cost(t.observations(o.metric)) for o in self._study.objectives])
            for t in trials
        ]
        points = self._points(trials)
        feasible = _log_feasibility(constraints, points) >= np.log(BELIEVED_FEASIBLE)
        means = np.array([values.mean(axis=0) for values in costs])
        chebyshev = Chebyshev.between(means, feasible, weights)
        x = np.repeat(points, [len(values) for values in costs], axis=0)
        y = np.concatenate([chebyshev.linearized(values) for values in costs])
        # Other weights than in the fit before make another response.
        return self._fit(OBJECTIVE, x, y, self._minimum, keep=False)

    def constraints(self, trials: Sequence[Trial]) -> dict[str, LimitedResponse]:
        found: dict[str, LimitedResponse] = {}
        for chance in self._study.chance_constraints:
            if self._options.pooled:
                found[chance.name] = self._over_contexts(trials, chance)
                continue
            x, y, _ = self._observations(trials, chance.metric)
            model = self._fit(chance.name, x, y, self._minimum)
            found[chance.name] = SurrogateConstraint.on_observation(
                model, chance.limit, chance.level, chance.sign
            )
        for worst in self._study.worst_case_constraints:
            found[worst.name] = self._worst(trials, worst)
        return found

    def classifier(
        self, trials: Sequence[Trial], positive: Callable[[Trial], bool]
    ) -> NeighbourClassifier:
        labels = np.array([positive(t) for t in trials], dtype=bool)
        points = self._coding.encode(self._points(trials))
        scales = np.full(points.shape[1], CLASSIFIER_SCALE)
        return NeighbourClassifier(points, labels, scales, encode=self._coding.encode)

    def _worst(self, trials: Sequence[Trial], worst: Constraint) -> LimitedResponse:
        if self._options.pooled:
            return self._every_context(trials, worst)
        if self._options.joint:
            return self._joint_worst_case(trials, worst)
        return self._worst_case(trials, worst)

    def _worst_case(self, trials: Sequence[Trial], worst: Constraint) -> SurrogateConstraint:
        y = single_evaluation_worst_cases(trials, worst)
        model = self._fit(worst.name, self._points(trials), y, self._minimum)
        return SurrogateConstraint.on_expectation(model, worst.limit, worst.sign)

    def _joint_worst_case(self, trials: Sequence[Trial], worst: Constraint) -> JointConstraint:
        contexts = self._study.context_space()
        x, c, y = joint_observations(self._space, contexts, trials, worst.metric)
        minimum = np.append(self._minimum, np.zeros(contexts.dimension))
        model = self._fit(worst.name, np.hstack([x, c]), y, minimum)
        margin = worst.sign * worst.deviations * model.noise_variance**0.5
        return JointConstraint(
            model, worst.limit - margin, worst.sign, contexts=contexts.candidates()
        )

    def _every_context(self, trials: Sequence[Trial], worst: Constraint) -> EveryContext:
        process = self._process(worst.name, trials, worst.metric)
        # The searches have looked where no corner is, and may have found the worst context there.
        candidates = self._study.context_space().candidates(searched_contexts(trials))
        return EveryContext(process, worst.limit, candidates, worst.deviations, worst.sign)

    def _over_contexts(self, trials: Sequence[Trial], chance: Constraint) -> OverContexts:
        process = self._process(chance.name, trials, chance.metric)
        contexts = self._study.context_space()
        drawn = contexts.draw_stratified(CHANCE_OVER, np.random.default_rng(0))
        return OverContexts(
            process, chance.limit, contexts.to_cube(drawn), chance.level, chance.sign
        )

    def crashes(self, trials: Sequence[Trial]) -> CrashModel:
        contexts = self._study.context_space()
        runs = [
            (point, evaluation)
            for trial, point in zip(trials, self._points(trials), strict=True)
            for evaluation in trial.evaluations
            if not evaluation.outcome.spoilt
        ]
        return CrashModel.fit(
            np.array([point for point, _ in runs]).reshape(-1, self._space.dimension),
            contexts.cube_of([evaluation.context for _, evaluation in runs]),
            np.array([e.outcome.state is not EvaluationState.COMPLETE for _, e in runs], bool),
            coding=self._coding,
            contexts=contexts.candidates(),
            neighbours=self.classifier(trials, lambda t: t.state is TrialState.FAILED),
            rng=self._rng,
            start=self._start.get(FAILURES) if self._keep else None,
        )

    def _process(
        self,
        name: str,
        trials: Sequence[Trial],
        metric: str,
        transform: Callable[[Array], Array] = np.asarray,
    ) -> JointProcess:
        contexts = self._study.context_space()
        x, c, y = joint_observations(self._space, contexts, trials, metric)
        process = JointProcess.fit(
            x,
            c,
            transform(y),
            coding=self._coding,
            rng=self._rng,
            minimum_length_scales=self._minimum,
            start=self._start.get(name),
            keep=self._keep,
        )
        self.models[name] = process
        return process

    def _fit(
        self, name: str, x: Array, y: Array, minimum: Array, *, keep: bool | None = None
    ) -> Model:
        fit = coded_fit(self._options.fit, self._coding)
        model = fit(
            x,
            y,
            rng=self._rng,
            minimum_length_scales=minimum,
            start=self._start.get(name),
            keep=self._keep if keep is None else keep,
        )
        self.models[name] = model
        return model

    def _points(self, trials: Sequence[Trial]) -> Array:
        for trial in trials:
            if trial.number not in self._cubes:
                self._cubes[trial.number] = self._space.to_cube(trial.parameters)
        rows = [self._cubes[trial.number] for trial in trials]
        return np.array(rows).reshape(-1, self._space.dimension)

    def _observations(
        self, trials: Sequence[Trial], metric: str
    ) -> tuple[Array, Array, NDArray[np.int_]]:
        """Return points (N, d), values (N,) and trial numbers (N,) of `Trial.observations`."""
        x, y, number = [], [], []
        for trial, point in zip(trials, self._points(trials), strict=True):
            for value in trial.observations(metric):
                x.append(point)
                y.append(value)
                number.append(trial.number)
        return np.array(x), np.array(y), np.array(number)
