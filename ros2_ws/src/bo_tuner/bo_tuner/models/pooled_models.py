"""Models of all evaluations, pooled in processes over parameter set and context.

One process for each objective and one for each limited metric, with local noise. Evaluations of a
trial that failed are data as far as they are complete, and not to fail is one more limit. Of a run
that was cut short, lower bounds are data (`bo_tuner.models.censoring`). Measured contexts are
further columns beside the contexts. An expectation or a probability is one over them, too; a
worst case is one over the contexts alone, of the mean over what was measured. Whether runs fail is
learnt without them, since a run that fails has not measured any. Runs of a simulation are data,
too, if there is one (`bo_tuner.models.simulation`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from bo_tuner.models.bias import Comparison
from bo_tuner.models.censoring import Censored
from bo_tuner.models.compression import NO_COMPRESSION, Compression
from bo_tuner.models.constraints import BELIEVED_FEASIBLE, log_feasibility
from bo_tuner.models.context_process import ContextProcess, ContextProcesses
from bo_tuner.models.covariates import Covariates, simulated_in
from bo_tuner.models.crashes import CrashModel
from bo_tuner.models.fitting import Fitting
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.models.model_scale import ModelScale, ScaleRule
from bo_tuner.models.observations import known_errors, searched_contexts
from bo_tuner.models.pooled_process import PooledProcesses
from bo_tuner.models.pooled_responses import (
    EveryContext,
    ExpectedObjective,
    OverContexts,
    PooledObjective,
    PooledResponse,
)
from bo_tuner.models.scalarization import Chebyshev
from bo_tuner.models.scalarized_objective import ScalarizedObjective
from bo_tuner.models.simulation import Simulation, is_simulated, moved
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import FAILURES, OBJECTIVE
from bo_tuner.study.limit_kinds.limited import Limited
from bo_tuner.study.parts import LOG, Objective
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Trial, TrialState, pooled

KNEE = 0.25
"""Quantile of the costs, where one run tells all, beyond which high ones are compressed.

Costs that span orders of magnitude leave a process nothing to see of the low ones.
"""

EXPECTED_OVER = 256
"""Number of contexts, the same in every fit, that an expectation is taken over."""

DRAWN_OVER = 64
"""Number of contexts, the same in every fit, that a limit over their distribution is over."""

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
    comparisons
        By metric the model of the machine beside its simulation; empty without one.
    """

    objective: PooledObjective | None
    constraints: Mapping[str, PooledResponse]
    crashes: CrashModel = field(kw_only=True)
    comparisons: Mapping[str, Comparison] = field(default_factory=dict, kw_only=True)

    @property
    def limits(self) -> tuple[PooledResponse, ...]:
        """The constraints, and the one on failures once there was any."""
        known = () if self.crashes.constraint is None else (self.crashes.constraint,)
        return (*self.constraints.values(), *known)

    @property
    def warm_starts(self) -> dict[str, tuple[float, ...]]:
        """Starting points for the next fit, by model name."""
        starts = super().warm_starts
        if self.crashes.warm_start is not None:
            starts[FAILURES] = self.crashes.warm_start
        return starts

    def weighted(self, weights: Array) -> Self:
        """Return the models with other weights (k,) of several objectives."""
        objective = None if self.objective is None else self.objective.weighted(weights)
        return replace(self, objective=objective)


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
    simulation
        Trials that are data besides those of the machine.
    """

    processes: ContextProcesses = field(default_factory=PooledProcesses)
    scale: ScaleRule = Compression.of
    looked: Looked = searched_contexts
    simulation: Simulation = field(default_factory=Simulation)

    @property
    def alone(self) -> Self:
        """The models of the machine's own runs."""
        return replace(self, simulation=Simulation())

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
        keep: bool = False,
    ) -> PooledSurrogates:
        """Fit all models; see `FitSurrogates`."""
        trials = pooled(trials)
        fitting = Fitting(study, trials, rng, start, keep=keep)
        complete = [t for t in trials if t.state is TrialState.COMPLETE]
        outliers = fitting.outliers(complete) if complete else frozenset()
        simulated = self.simulation
        covariates = Covariates.of(study, [*simulated.trials, *trials])
        objective: PooledObjective | None = None
        costs: dict[str, ExpectedObjective] = {}
        constraints: dict[str, PooledResponse] = {}
        comparisons: dict[str, Comparison] = {}
        if complete:
            # The complete evaluations of a failed trial are data for their contexts.
            kept = [*simulated.usual, *(t for t in trials if t.number not in outliers)]
            data = _Data(fitting, kept, covariates)
            costs = self._costs(data, several=weights is not None)
            constraints, comparisons = self._constraints(data), data.comparisons
            objective = costs[study.objective.metric]
            if weights is not None:
                points = fitting.points([t for t in complete if t.number not in outliers])
                objective = _scalarized(costs.values(), constraints.values(), points, weights)
        crashes = self._crashes(fitting, [*simulated.trials, *trials])
        outlying = None
        if complete:
            of_simulation = [t for t in simulated.trials if t.state is TrialState.COMPLETE]
            known = outliers | simulated.outliers
            outlying = fitting.classifier([*of_simulation, *complete], lambda t: t.number in known)
        return PooledSurrogates(
            objective,
            constraints,
            crashes,
            outlying,
            outliers,
            fitting.models,
            costs,
            crashes=crashes,
            comparisons=comparisons,
        )

    def _costs(self, data: "_Data", *, several: bool) -> dict[str, ExpectedObjective]:
        """Return the models of the costs by metric: of all objectives, or of the first alone."""
        study = data.fitting.study
        costs: dict[str, ExpectedObjective] = {}
        for objective in study.objectives if several else (study.objective,):
            name = f"{OBJECTIVE}_{objective.metric}" if costs else OBJECTIVE
            costs[objective.metric] = self._cost(data, objective, name, several=several)
        return costs

    def _cost(
        self, data: "_Data", objective: Objective, name: str, *, several: bool
    ) -> ExpectedObjective:
        """Return the model of a cost."""
        metric, fitting = objective.metric, data.fitting
        x, c, y = data.observations(metric)
        cost = objective.to_cost(y)
        compression = NO_COMPRESSION
        if fitting.study.a_run_tells_all and data.covariates.simulated is None and not several:
            compression = Compression.of(cost, float(np.quantile(cost, KNEE)))

        def apply(values: Array) -> Array:
            return compression.apply(objective.to_cost(values))

        censored = None
        if objective.sign > 0.0:
            # Of what is maximized a lower bound is one that the cost stays below.
            censored = fitting.censored_observations(data.trials, metric).on_scale(apply)
        runs, errors = (x, c, compression.apply(cost)), data.errors(metric, y, apply)
        process = data.process(
            self.processes, name, metric, runs, censored, objective.from_cost, errors
        )
        return ExpectedObjective(process, data.over, objective, data.tried, compression)

    def _constraints(self, data: "_Data") -> dict[str, PooledResponse]:
        """Return the limits, with the models of their responses, by name."""
        study, responses = data.fitting.study, _Responses(self, data)
        ordered = (*study.drawn_constraints, *study.worst_case_constraints)
        return {constraint.name: constraint.rule.response(responses) for constraint in ordered}

    def _crashes(self, fitting: Fitting, trials: Sequence[Trial]) -> CrashModel:
        """Return the probability that a run fails, as a constraint."""
        contexts = fitting.study.context_space()
        # Nobody knows whether a run that was cut short would have failed.
        trials = [trial for trial in trials if trial.state is not TrialState.CUT_SHORT]
        runs = [
            (point, evaluation)
            for trial, point in zip(trials, fitting.points(trials), strict=True)
            for evaluation in trial.evaluations
            if not evaluation.outcome.unusable
        ]
        return CrashModel.fit(
            np.array([point for point, _ in runs]).reshape(-1, len(fitting.minimum)),
            contexts.cube_of([evaluation.context for _, evaluation in runs]),
            np.array([not e.outcome.complete for _, e in runs], bool),
            processes=self.processes,
            coding=fitting.coding,
            contexts=contexts.candidates(),
            neighbours=fitting.classifier(
                [t for t in trials if not t.unusable], lambda t: t.state is TrialState.FAILED
            ),
            rng=fitting.rng,
            start=fitting.kept(FAILURES),
        )


@dataclass(frozen=True)
class _Data:
    """What is fitted to: the runs of the trials, and of a simulation if there is one.

    Attributes
    ----------
    fitting
        Of the study.
    trials
        The trials, those of the simulation first.
    covariates
        Of all of them.
    comparisons
        By metric the models of machine and simulation; empty without a simulation.
    """

    fitting: Fitting
    trials: Sequence[Trial]
    covariates: Covariates
    comparisons: dict[str, Comparison] = field(default_factory=dict)

    @cached_property
    def over(self) -> Array:
        """Drawn contexts (k, e + w') of the machine that an expectation is taken over."""
        contexts = self.fitting.study.context_space()
        drawn = contexts.draw_stratified(EXPECTED_OVER, np.random.default_rng(0))
        return self.covariates.beside(contexts.to_cube(drawn))

    @cached_property
    def tried(self) -> tuple[Array, Array] | None:
        """See `ExpectedObjective`: parameter sets (p, d) that the machine has run."""
        if self.covariates.simulated is None:
            return None
        counts = [
            0 if is_simulated(trial) else sum(e.outcome.complete for e in trial.evaluations)
            for trial in self.trials
        ]
        runs = np.array(counts)
        return self.fitting.points(self.trials)[runs > 0], runs[runs > 0]

    def observations(self, metric: str) -> tuple[Array, Array, Array]:
        """Return as `joint_observations`, the contexts (N, e + w') with the further columns."""
        x, c, y = self.fitting.joint_observations(self.trials, metric)
        if self.covariates.width:
            c = np.hstack([c, self.covariates.columns(self.fitting.study, self.trials)])
        return x, c, y

    def errors(self, metric: str, y: Array, apply: Callable[[Array], Array]) -> Array | None:
        """Return the known standard errors (N,) of the values y (N,), on the scale of a model."""
        known = known_errors(self.trials, metric)
        return None if known is None else np.abs(apply(y + known) - apply(y))

    def process(
        self,
        processes: ContextProcesses,
        name: str,
        metric: str,
        runs: tuple[Array, Array, Array],
        censored: Censored | None,
        restore: Callable[[Array], Array],
        errors: Array | None,
    ) -> ContextProcess:
        """Fit the process of a metric; with a simulation, it is compared with that.

        Parameters
        ----------
        processes, name, censored
            As in `Fitting.process`.
        metric
            Its name.
        runs : tuple of ndarray
            Its `observations`, on the scale of the model.
        restore
            From that scale to the metric's unit.
        errors : ndarray, shape (N,), or None
            Of `errors`.
        """
        x, c, y = runs
        if self.covariates.simulated is None:
            return self.fitting.process(processes, name, x, c, y, censored, errors)
        y, offset = moved(x, y, simulated_in(self.trials))
        process = self.fitting.process(processes, name, x, c, y, censored, errors)
        self.comparisons.setdefault(metric, Comparison(process, self.over, offset, restore))
        return process


@dataclass(frozen=True)
class _Responses:
    """What pooled models can predict: `bo_tuner.study.limit_kinds.base.Responses`."""

    models: PooledModels
    data: _Data

    def in_every_context(self, limited: Limited, deviations: float) -> PooledResponse:
        """Return the limit in every context."""
        process, scale = self._process(limited)
        study, covariates = self.data.fitting.study, self.data.covariates
        if covariates.width:
            process = process.averaged(covariates.to_average)
        # The searches have looked where no corner is, and may have found the worst context there.
        candidates = study.context_space().candidates(self.models.looked(self.data.trials))
        return EveryContext(process, limited.limit, candidates, deviations, limited.sign, scale)

    def over_contexts(self, limited: Limited, level: float) -> PooledResponse:
        """Return the limit over contexts and noise."""
        process, scale = self._process(limited)
        contexts = self.data.fitting.study.context_space()
        drawn = contexts.to_cube(contexts.draw_stratified(DRAWN_OVER, np.random.default_rng(0)))
        over = self.data.covariates.beside(drawn)
        return OverContexts(process, limited.limit, over, level, limited.sign, scale)

    def _process(self, limited: Limited) -> tuple[ContextProcess, ModelScale]:
        """Return the process of the limited metric, and the scale that it is on."""
        data, fitting = self.data, self.data.fitting
        x, c, y = data.observations(limited.metric)
        rule = self.models.of_metric(fitting.study, limited.metric).scale
        scale, processes = rule(y, limited.limit, limited.sign), self.models.processes
        censored = fitting.censored_observations(data.trials, limited.metric)
        censored = censored.on_scale(scale.apply)
        runs, metric = (x, c, scale.apply(y)), limited.metric
        errors = data.errors(metric, y, scale.apply)
        process = data.process(
            processes, limited.name, metric, runs, censored, scale.restore, errors
        )
        return process, scale


def _scalarized(
    costs: Iterable[ExpectedObjective],
    constraints: Iterable[PooledResponse],
    points: Array,
    weights: Array,
) -> ScalarizedObjective:
    """Return the cost of k objectives with weights (k,), scaled by the front of points (n, d)."""
    each = tuple(costs)
    means = np.column_stack([cost.predict_mean(points) for cost in each])
    feasible = log_feasibility(constraints, points) >= np.log(BELIEVED_FEASIBLE)
    return ScalarizedObjective(each, Chebyshev.between(means, feasible, weights))
