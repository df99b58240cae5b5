"""Fits of the models of one study's responses to its trials.

Which responses these are, and what the models are asked, is in `bo_tuner.models.surrogates`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding, coded, coded_fit
from bo_tuner.models.compression import Compression
from bo_tuner.models.constraints import (
    BELIEVED_FEASIBLE,
    JointConstraint,
    LimitedResponse,
    SurrogateConstraint,
    log_feasibility,
)
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.observations import (
    joint_observations,
    searched_contexts,
    single_evaluation_worst_cases,
)
from bo_tuner.models.pooled_process import PooledProcess
from bo_tuner.models.pooled_responses import EveryContext, ExpectedObjective, OverContexts
from bo_tuner.models.protocol import FitModel, Fitted, Model
from bo_tuner.models.scalarization import Chebyshev
from bo_tuner.models.student_t import find_outliers
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import FAILURES, OBJECTIVE, OUTLIERS, Constraint
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState

# Length scale of the classifiers in the unit cube. The objective's length scales do not suit them:
# they are fitted to complete trials only, and are long if the response is flat.
CLASSIFIER_SCALE = 0.25

EXPECTED_OVER = 256
"""Number of contexts, the same in every fit, that an expectation is taken over."""

CHANCE_OVER = 64
"""Number of contexts, the same in every fit, that the probability of a chance limit is over."""

FITTED_EACH = 100
"""Number of trials up to which the hyperparameters are fitted anew after each of them."""

GROWTH = 0.1
"""Part by which the number of trials grows between fits of the hyperparameters after that.

A fit is most of the time of a proposal then, and one of many trials changes it little. So the
number of fits grows with the logarithm of the trials.
"""


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


def fitted_after(trials: int) -> bool:
    """Return whether hyperparameters are fitted after so many trials, or those before are kept."""
    if trials <= FITTED_EACH:
        return True
    now, before = (np.log(n / FITTED_EACH) // np.log1p(GROWTH) for n in (trials, trials - 1))
    return bool(now > before)


class Fitting:
    """Fits the models of one study to trials, and collects them.

    Parameters
    ----------
    study
        The study.
    rng
        Draws starting points of the hyperparameter fits.
    start
        Hyperparameters of an earlier fit, by the names of the models.
    options
        Which models to fit.
    keep
        Whether the hyperparameters of `start` are kept, where there are any.

    Attributes
    ----------
    models
        The models fitted so far, by name.
    """

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
        """Return the numbers of the complete trials that are outliers of an objective."""
        found = self._outliers(complete, self._study.objective, OUTLIERS)
        for further in self._study.further_objectives:
            found |= self._outliers(complete, further, f"{OUTLIERS}_{further.metric}")
        return found

    def _outliers(
        self, complete: Sequence[Trial], objective: Objective, name: str
    ) -> frozenset[int]:
        x, y, number = self._observations(complete, objective.metric)
        if not len(y):
            # All are from contexts of another distribution.
            return frozenset()
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
        """Return the model of the cost, that of the first objective."""
        if self._options.pooled:
            objective, contexts = self._study.objective, self._study.context_space()
            x, c, y = self._joint_observations(trials, objective.metric)
            process = self._process(OBJECTIVE, x, c, objective.to_cost(y))
            drawn = contexts.draw_stratified(EXPECTED_OVER, np.random.default_rng(0))
            return ExpectedObjective(process, contexts.to_cube(drawn), objective)
        x, y, _ = self._observations(trials, self._study.objective.metric)
        return self._fit(OBJECTIVE, x, self._study.objective.to_cost(y), self._minimum)

    def scalarized(
        self, trials: Sequence[Trial], constraints: Iterable[LimitedResponse], weights: Array
    ) -> Model:
        """Return the model of the scalarization of k objectives with weights (k,)."""
        costs = [
            np.column_stack([o.to_cost(t.observations(o.metric)) for o in self._study.objectives])
            for t in trials
        ]
        points = self._points(trials)
        feasible = log_feasibility(constraints, points) >= np.log(BELIEVED_FEASIBLE)
        means = np.array([values.mean(axis=0) for values in costs])
        chebyshev = Chebyshev.between(means, feasible, weights)
        x = np.repeat(points, [len(values) for values in costs], axis=0)
        y = np.concatenate([chebyshev.linearized(values) for values in costs])
        # Other weights than in the fit before make another response.
        return self._fit(OBJECTIVE, x, y, self._minimum, keep=False)

    def constraints(self, trials: Sequence[Trial]) -> dict[str, LimitedResponse]:
        """Return the limits, with the models of their responses, by name."""
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
        """Return the probability that a trial is positive, by its nearest neighbours."""
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
        return SurrogateConstraint(model, worst.limit, worst.sign)

    def _joint_worst_case(self, trials: Sequence[Trial], worst: Constraint) -> JointConstraint:
        contexts = self._study.context_space()
        x, c, y = self._joint_observations(trials, worst.metric)
        minimum = np.append(self._minimum, np.zeros(contexts.dimension))
        model = self._fit(worst.name, np.hstack([x, c]), y, minimum)
        margin = worst.sign * worst.deviations * model.noise_variance**0.5
        return JointConstraint(
            model, worst.limit - margin, worst.sign, contexts=contexts.candidates()
        )

    def _every_context(self, trials: Sequence[Trial], worst: Constraint) -> EveryContext:
        process, compression = self._limited(trials, worst)
        # The searches have looked where no corner is, and may have found the worst context there.
        candidates = self._study.context_space().candidates(searched_contexts(trials))
        return EveryContext(
            process, worst.limit, candidates, worst.deviations, worst.sign, compression
        )

    def _over_contexts(self, trials: Sequence[Trial], chance: Constraint) -> OverContexts:
        process, compression = self._limited(trials, chance)
        contexts = self._study.context_space()
        drawn = contexts.draw_stratified(CHANCE_OVER, np.random.default_rng(0))
        return OverContexts(
            process, chance.limit, contexts.to_cube(drawn), chance.level, chance.sign, compression
        )

    def crashes(self, trials: Sequence[Trial]) -> CrashModel:
        """Return the probability that a run fails, as a constraint."""
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
            np.array([not e.outcome.complete for _, e in runs], bool),
            coding=self._coding,
            contexts=contexts.candidates(),
            neighbours=self.classifier(
                [t for t in trials if not t.spoilt], lambda t: t.state is TrialState.FAILED
            ),
            rng=self._rng,
            start=self._start.get(FAILURES) if self._keep else None,
        )

    def _limited(
        self, trials: Sequence[Trial], constraint: Constraint
    ) -> tuple[PooledProcess, Compression]:
        x, c, y = self._joint_observations(trials, constraint.metric)
        compression = Compression.of(y, constraint.limit, constraint.sign)
        return self._process(constraint.name, x, c, compression.apply(y)), compression

    def _joint_observations(
        self, trials: Sequence[Trial], metric: str
    ) -> tuple[Array, Array, Array]:
        contexts = self._study.context_space()
        return joint_observations(self._points(trials), contexts, trials, metric)

    def _process(self, name: str, x: Array, c: Array, y: Array) -> PooledProcess:
        process = PooledProcess.fit(
            x,
            c,
            y,
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
        values = [trial.observations(metric) for trial in trials]
        counts = [len(found) for found in values]
        x = np.repeat(self._points(trials), counts, axis=0)
        number = np.repeat([trial.number for trial in trials], counts)
        return x, np.array([value for found in values for value in found]), number
