"""The truth of a parameter set, from many more evaluations than a tuner has.

A judge that the experiment names, such as `tuning_benchmark.milling.judge:Judge`, knows the nodes
and computes many evaluations at once. This module chooses the contexts that it judges in, and
decides by evaluations on the study's own objects whether the chance constraints hold.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.limits import judge_sample
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import parse_study, study_to_yaml
from bo_tuner.trials import Context, Value
from tuning_benchmark.experiments import plugins
from tuning_benchmark.judging.evaluator import Evaluator

SEED = 20_201_115
"""Of all draws here; far from the seeds of the runs that are judged."""

FEW_REAL_EVALUATIONS = 2
"""Evaluations on the objects for the incumbents on the way, where the answers have many."""


@dataclass(frozen=True)
class Effort:
    """Number of evaluations behind a verdict.

    Attributes
    ----------
    drawn
        Contexts drawn from the distribution, for the expectation.
    grid
        Values of each context variable, among which the worst context is sought.
    real_evaluations
        Evaluations on the objects for the chance constraints.
    """

    drawn: int = 600
    grid: int = 7
    real_evaluations: int = 25


@dataclass(frozen=True)
class Judgement:
    """What a judge finds of one parameter set; NaN where an evaluation failed.

    Attributes
    ----------
    objective, standard_error
        Mean over the drawn contexts, and its standard error.
    worst, worst_index
        Largest mean over noise of the constrained metric, of all contexts of the grid, and the row
        of the grid where it is.
    single
        The constrained metric of one evaluation in each drawn context (drawn,).
    """

    objective: float
    standard_error: float
    worst: float
    worst_index: int
    single: Array


class Judge(Protocol):
    """Computes many evaluations at once.

    Parameters
    ----------
    constants
        Parameters of each node that stay, by the study's names of the nodes.
    drawn, grid
        Contexts: values by the node's own parameter name, (drawn,) and (grid,).
    corners
        Rows of the grid that are corners of the box of contexts.
    seed
        Of all noise.
    """

    def __init__(
        self,
        constants: Mapping[str, Mapping[str, Any]],
        drawn: Mapping[str, Array],
        grid: Mapping[str, Array],
        corners: NDArray[np.intp],
        seed: int,
    ) -> None: ...

    def judge(self, values: Mapping[str, Mapping[str, Any]]) -> Judgement:
        """Judge the values of a parameter set, by node."""
        ...

    def worst_runs(self, values: Mapping[str, Mapping[str, Any]]) -> Array:
        """Return the constrained metric (c, m) of m runs in each of the c worst contexts.

        The contexts are those of the grid in
        which a run most likely exceeds it; NaN for a run that failed.
        """
        ...


@dataclass(frozen=True)
class Verdict:
    """The truth of one parameter set.

    Attributes
    ----------
    objective, standard_error
        Expectation of the objective's metric, and its standard error.
    worst, worst_context
        Worst case of the constrained metric, the largest mean over noise, and where.
    worst_kept
        Realized probability: share of runs within the limit in the context where it is smallest.
        NaN if evaluations fail, and for an incumbent whose limit is on the mean over noise.
    single_violation
        Share of single evaluations in drawn contexts beyond the limit.
    within_limits
        For each chance constraint, share of evaluations within its limit.
    feasible
        Whether the chance constraints hold, and the limit of the worst case as the study means it:
        for the mean over noise, or for the probability of a run.
    """

    objective: float
    standard_error: float
    worst: float
    worst_context: Context
    worst_kept: float
    single_violation: float
    within_limits: Mapping[str, float]
    feasible: bool


class Truth:
    """Judges parameter sets of a study.

    Parameters
    ----------
    study
        With a worst-case constraint; its objects run in process.
    judge
        Class of the judge, as ``module:Class``.
    effort
        Number of evaluations.

    Raises
    ------
    StudyError
        If the study has not one worst-case constraint with an upper limit, or the judge cannot be
        loaded or refuses it.
    """

    def __init__(self, study: Study, judge: str, effort: Effort = Effort()) -> None:
        worst = study.worst_case_constraints
        if len(worst) != 1 or worst[0].sign < 0.0:
            raise StudyError("expected one worst_case constraint, an upper limit, for the judge")
        (constraint,) = worst
        self.study = study
        self.effort = effort
        self.limit = constraint.limit
        self.constraint = constraint
        space = study.context_space()
        rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(0,)))
        self.drawn_contexts = space.draw_stratified(effort.drawn, rng)
        axes = [np.linspace(0.0, 1.0, effort.grid)] * space.dimension
        cube = np.array(np.meshgrid(*axes, indexing="ij")).reshape(space.dimension, -1).T
        self.grid_contexts = space.to_contexts(cube)
        self.corners = np.flatnonzero(np.isin(cube, (0.0, 1.0)).all(axis=1))
        constants = {
            key: dict(node.parameters) | dict(node.inprocess_parameters)
            for key, node in study.nodes.items()
        }
        loaded = plugins.load(judge, "judge")
        try:
            self.judge = loaded(
                constants,
                self._columns(self.drawn_contexts),
                self._columns(self.grid_contexts),
                self.corners,
                SEED,
            )
        except Exception as error:  # Foreign code again.
            problem = " ".join(f"{type(error).__name__}: {error}".split())
            raise StudyError(f"{judge} cannot judge {study.name}: {problem}", ("judge",)) from error

    def verdict(
        self, parameters: Mapping[str, Value], real_evaluations: int | None = None
    ) -> Verdict:
        """Judge a parameter set.

        Parameters
        ----------
        parameters
            Every parameter of the study.
        real_evaluations
            Evaluations for the chance constraints, if not those of the effort.
        """
        values = self.study.assignments(parameters, {}, 0)
        judged: Judgement = self.judge.judge(values)
        within, holds = self.meets_chances(parameters, real_evaluations)
        on_mean = not self.constraint.rule.on_runs
        kept = float("nan")
        # An answer is shown with what it realizes; whether an incumbent is feasible is enough.
        if not np.isnan(judged.worst) and not (on_mean and real_evaluations is not None):
            kept = float(np.mean(self.judge.worst_runs(values) <= self.limit, axis=1).min())
        holds_worst = judged.worst <= self.limit if on_mean else kept >= self.constraint.level
        return Verdict(
            objective=judged.objective,
            standard_error=judged.standard_error,
            worst=judged.worst,
            worst_context=self.study.context_space().to_dict(
                self.grid_contexts[judged.worst_index]
            ),
            worst_kept=kept,
            single_violation=float(np.mean(~(judged.single <= self.limit))),
            within_limits=within,
            feasible=bool(holds_worst and holds),
        )

    def meets_chances(
        self, parameters: Mapping[str, Value], real_evaluations: int | None = None
    ) -> tuple[dict[str, float], bool]:
        """Return the shares of evaluations within the chance constraints, and whether all hold."""
        evaluator = Evaluator(self.study)
        space = self.study.context_space()
        chances = self.study.drawn_constraints
        seen: dict[str, list[float]] = {constraint.name: [] for constraint in chances}
        count = self.effort.real_evaluations if real_evaluations is None else real_evaluations
        rows = np.linspace(0, self.effort.drawn - 1, count).astype(int)
        for number, row in enumerate(rows):
            context = space.to_dict(self.drawn_contexts[row])
            metrics = evaluator.metrics(parameters, context, SEED + number)
            for constraint in chances:
                # An evaluation that failed keeps no limit, on whichever side it is.
                failed = constraint.sign * np.inf
                seen[constraint.name].append(metrics.get(constraint.metric, failed))
        samples = [judge_sample(constraint, seen[constraint.name]) for constraint in chances]
        shares = {s.name: (s.count - s.violations) / s.count for s in samples}
        return shares, all(sample.agrees for sample in samples)

    def _columns(self, contexts: Array) -> dict[str, Array]:
        variables = self.study.contexts.values()
        return {item.parameter: contexts[:, i] for i, item in enumerate(variables)}


@lru_cache(maxsize=4)
def _truth(text: str, judge: str) -> Truth:
    return Truth(parse_study(text), judge)


def truth_of(study: Study, judge: str) -> Truth:
    """Return a study's truth; all runs share its contexts and noise, whatever their seed."""
    return _truth(study_to_yaml(study.replace(seed=1)), judge)


def verdict_record(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as JSON takes it, with None for what is not a finite number."""
    record = asdict(verdict)
    return {
        key: None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in record.items()
    }
