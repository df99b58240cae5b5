"""Models of all evaluations, pooled in processes over parameter set and context.

One process for the objective and one for each limited metric, with local noise. Evaluations of a
trial that failed are data as far as they are complete, and not to fail is one more limit. Measured
contexts are further columns beside the contexts. An expectation or a probability is one over them,
too; a worst case is one over the contexts alone, of the mean over what was measured. Whether runs
fail is learnt without them, since a run that fails has not measured any.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from bo_tuner.models.compression import Compression
from bo_tuner.models.context_process import ContextProcess, ContextProcesses
from bo_tuner.models.covariates import ROWS, Covariates, measured_in
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.fitting import Fitting
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.models.model_scale import ModelScale, ScaleRule
from bo_tuner.models.observations import searched_contexts
from bo_tuner.models.pooled_process import PooledProcesses
from bo_tuner.models.pooled_responses import (
    EveryContext,
    ExpectedObjective,
    OverContexts,
    PooledResponse,
)
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import FAILURES, OBJECTIVE, Constraint
from bo_tuner.study.parts import LOG
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Trial, TrialState, pooled

EXPECTED_OVER = 256
"""Number of contexts, the same in every fit, that an expectation is taken over."""

CHANCE_OVER = 64
"""Number of contexts, the same in every fit, that the probability of a chance limit is over."""

Looked = Callable[[Sequence[Trial]], Sequence[Context]]
"""Returns the contexts where trials have looked for the worst one, which are candidates for it."""


@dataclass(frozen=True, eq=False)
class PooledSurrogates(Surrogates):
    """Models of all evaluations.

    Attributes
    ----------
    objective
        Model of the cost; None while no trial is complete.
    constraints
        Constraints by their names in the study; empty while no trial is complete.
    crashes
        Probability of a failure, as a limit.
    """

    objective: ExpectedObjective | None
    constraints: Mapping[str, PooledResponse]
    crashes: CrashModel = field(kw_only=True)

    @property
    def limits(self) -> tuple[PooledResponse, ...]:
        """The constraints, and the one on failures once there was any."""
        known = () if self.crashes.constraint is None else (self.crashes.constraint,)
        return (*self.constraints.values(), *known)

    @property
    def warm_starts(self) -> dict[str, tuple[float, ...]]:
        """Starting points for the next fit, by model name."""
        found = super().warm_starts
        if self.crashes.warm_start is not None:
            found[FAILURES] = self.crashes.warm_start
        return found


@dataclass(frozen=True)
class PooledModels:
    """Fits the models of all evaluations; see `FitSurrogates`.

    Attributes
    ----------
    processes
        The kind of process.
    scale
        Chooses the scale on which a limited metric is modelled, unless the study asks for the
        logarithm.
    looked
        Returns contexts that are candidates for the worst one, besides corners and a hypercube.
    """

    processes: ContextProcesses = field(default_factory=PooledProcesses)
    scale: ScaleRule = Compression.of
    looked: Looked = searched_contexts

    def of_metric(self, study: Study, metric: str) -> Self:
        """Return them with the logarithm for a metric for which the study asks for it."""
        return replace(self, scale=Logarithm.of) if study.metrics[metric].scale == LOG else self

    def __call__(
        self,
        study: Study,
        trials: Sequence[Trial],
        *,
        rng: np.random.Generator,
        start: Mapping[str, Sequence[float]] | None = None,
        weights: Array | None = None,
    ) -> PooledSurrogates:
        """Fit all models; see `FitSurrogates`.

        Raises
        ------
        ValueError
            If there are weights: the cost is that of a single objective.
        """
        if weights is not None:
            raise ValueError("models of all evaluations are those of one objective")
        trials = pooled(trials)
        fitting = Fitting(study, trials, rng, start)
        complete = [t for t in trials if t.state is TrialState.COMPLETE]
        outliers = fitting.outliers(complete) if complete else frozenset()
        covariates = Covariates.of(study, trials)
        objective: ExpectedObjective | None = None
        constraints: dict[str, PooledResponse] = {}
        if complete:
            # A failed trial's complete evaluations tell of the contexts that they were in.
            kept = [t for t in trials if t.number not in outliers]
            objective = self._objective(fitting, kept, covariates)
            constraints = self._constraints(fitting, kept, covariates)
        crashes = self._crashes(fitting, trials)
        outlying = None
        if complete:
            outlying = fitting.classifier(complete, lambda t: t.number in outliers)
        return PooledSurrogates(
            objective, constraints, crashes, outlying, outliers, fitting.models, crashes=crashes
        )

    def _objective(
        self, fitting: Fitting, trials: Sequence[Trial], covariates: Covariates
    ) -> ExpectedObjective:
        """Return the model of the cost."""
        objective, contexts = fitting.study.objective, fitting.study.context_space()
        x, c, y = _observations(fitting, trials, covariates, objective.metric)
        process = fitting.process(self.processes, OBJECTIVE, x, c, objective.to_cost(y))
        drawn = contexts.draw_stratified(EXPECTED_OVER, np.random.default_rng(0))
        over = covariates.beside(contexts.to_cube(drawn))
        return ExpectedObjective(process, over, objective)

    def _constraints(
        self, fitting: Fitting, trials: Sequence[Trial], covariates: Covariates
    ) -> dict[str, PooledResponse]:
        """Return the limits, with the models of their responses, by name."""
        found: dict[str, PooledResponse] = {}
        for chance in fitting.study.chance_constraints:
            found[chance.name] = self._over_contexts(fitting, trials, covariates, chance)
        for worst in fitting.study.worst_case_constraints:
            found[worst.name] = self._every_context(fitting, trials, covariates, worst)
        return found

    def _every_context(
        self,
        fitting: Fitting,
        trials: Sequence[Trial],
        covariates: Covariates,
        worst: Constraint,
    ) -> EveryContext:
        process, scale = self._limited(fitting, trials, covariates, worst)
        if fitting.study.measured:
            process = process.averaged(covariates.rows(ROWS))
        # The searches have looked where no corner is, and may have found the worst context there.
        candidates = fitting.study.context_space().candidates(self.looked(trials))
        return EveryContext(process, worst.limit, candidates, worst.deviations, worst.sign, scale)

    def _over_contexts(
        self,
        fitting: Fitting,
        trials: Sequence[Trial],
        covariates: Covariates,
        chance: Constraint,
    ) -> OverContexts:
        process, scale = self._limited(fitting, trials, covariates, chance)
        contexts = fitting.study.context_space()
        drawn = contexts.to_cube(contexts.draw_stratified(CHANCE_OVER, np.random.default_rng(0)))
        over = covariates.beside(drawn)
        return OverContexts(process, chance.limit, over, chance.level, chance.sign, scale)

    def _limited(
        self,
        fitting: Fitting,
        trials: Sequence[Trial],
        covariates: Covariates,
        constraint: Constraint,
    ) -> tuple[ContextProcess, ModelScale]:
        x, c, y = _observations(fitting, trials, covariates, constraint.metric)
        rule = self.of_metric(fitting.study, constraint.metric).scale
        scale = rule(y, constraint.limit, constraint.sign)
        return fitting.process(self.processes, constraint.name, x, c, scale.apply(y)), scale

    def _crashes(self, fitting: Fitting, trials: Sequence[Trial]) -> CrashModel:
        """Return the probability that a run fails, as a constraint."""
        contexts = fitting.study.context_space()
        runs = [
            (point, evaluation)
            for trial, point in zip(trials, fitting.points(trials), strict=True)
            for evaluation in trial.evaluations
            if not evaluation.outcome.spoilt
        ]
        return CrashModel.fit(
            np.array([point for point, _ in runs]).reshape(-1, len(fitting.minimum)),
            contexts.cube_of([evaluation.context for _, evaluation in runs]),
            np.array([not e.outcome.complete for _, e in runs], bool),
            processes=self.processes,
            coding=fitting.coding,
            contexts=contexts.candidates(),
            neighbours=fitting.classifier(
                [t for t in trials if not t.spoilt], lambda t: t.state is TrialState.FAILED
            ),
            rng=fitting.rng,
            start=fitting.kept(FAILURES),
        )


def _observations(
    fitting: Fitting, trials: Sequence[Trial], covariates: Covariates, metric: str
) -> tuple[Array, Array, Array]:
    """Return as `joint_observations`, the contexts (N, e + w) with those that are measured."""
    x, c, y = fitting.joint_observations(trials, metric)
    if fitting.study.measured:
        c = np.hstack([c, covariates.unit(measured_in(fitting.study, trials))])
    return x, c, y
