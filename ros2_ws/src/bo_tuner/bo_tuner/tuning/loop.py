"""The run: trials of stage one, each with its evaluations of stage two, on any backend."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.models.surrogates import joint_observations
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.algorithms import Method
from bo_tuner.optimizers.stage_one import Proposal
from bo_tuner.study.parts import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    Value,
    WorstCase,
)
from bo_tuner.worst_case.joint_search import JointSearch
from bo_tuner.worst_case.search import OBSERVED, WorstCaseSearch, worst_contexts_nearby

LOST_IN_A_ROW = 3
"""So many trials in a row lost with their nodes end a run."""

EvaluationObserver = Callable[[Evaluation, Mapping[str, Value]], None]


class Tuning:
    """A run of a study.

    Iterating over it runs the trials that are left, one by one.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluations; open.
    method
        The algorithm.
    observe
        Called after each evaluation with the evaluation and its parameter set, before anything
        builds on it.
    trials
        Trials of an earlier session of the same run.
    """

    def __init__(
        self,
        study: Study,
        backend: Backend,
        method: Method,
        *,
        observe: EvaluationObserver = lambda evaluation, parameters: None,
        trials: Sequence[Trial] = (),
    ) -> None:
        self._study = study
        self._backend = backend
        self._method = method
        self._observe = observe
        self._stage_one = method.stage_one(study)
        self._contexts = study.context_space()
        self._lost = 0
        self.trials: list[Trial] = []
        for trial in trials:
            self._take(trial)

    def __iter__(self) -> Iterator[Trial]:
        """Run the trials that are left.

        Raises
        ------
        RunError
            If three trials in a row were lost with their nodes.
        """
        while len(self.trials) < self._study.budget.trials:
            begin = time.monotonic()
            proposal = self._stage_one.ask()
            trial = self._evaluate(len(self.trials), proposal, time.monotonic() - begin)
            self._take(trial)
            yield trial
            if self._lost >= LOST_IN_A_ROW:
                raise RunError(
                    f"{self._lost} trials in a row were lost with their nodes: {trial.reason}"
                )

    def _take(self, trial: Trial) -> None:
        self.trials.append(trial)
        self._stage_one.tell(trial)
        lost = any(
            evaluation.outcome.state is EvaluationState.LOST for evaluation in trial.evaluations
        )
        self._lost = self._lost + 1 if lost else 0

    def _evaluate(self, number: int, proposal: Proposal, seconds: float) -> Trial:
        evaluations: list[Evaluation] = []

        def finish(state: TrialState, reason: str, worst_case: WorstCase | None) -> Trial:
            return Trial(
                number=number,
                parameters=proposal.parameters,
                origin=proposal.origin,
                state=state,
                reason=reason,
                evaluations=tuple(evaluations),
                worst_case=worst_case,
                warnings=proposal.warnings,
                hyperparameters=proposal.hyperparameters,
                seconds=seconds,
            )

        def run(stage: Stage, context: Mapping[str, float]) -> Outcome:
            seed = noise_seed(self._study.seed, Stream.NOISE, number, len(evaluations))
            evaluation = run_cut(
                self._study,
                self._backend,
                proposal.parameters,
                Evaluation(number, len(evaluations), stage, context, seed),
            )
            evaluations.append(evaluation)
            self._observe(evaluation, proposal.parameters)
            return evaluation.outcome

        for stage, context in self._estimating_contexts(number):
            outcome = run(stage, context)
            if outcome.state is not EvaluationState.COMPLETE:
                return finish(TrialState.FAILED, outcome.reason, None)
        constraint = self._study.worst_case_constraint
        if constraint is None:
            return finish(TrialState.COMPLETE, "", None)
        search = self._search(constraint, proposal)
        for evaluation in evaluations:
            search.tell(evaluation.context, evaluation.outcome.metrics[constraint.metric])

        def rng() -> np.random.Generator:
            return generator(self._study.seed, Stream.SEARCH, number, len(evaluations))

        while not search.done(rng()):
            context = search.ask(rng())
            outcome = run(Stage.SEARCH, context)
            if outcome.state is not EvaluationState.COMPLETE:
                return finish(TrialState.FAILED, outcome.reason, None)
            search.tell(context, outcome.metrics[constraint.metric])
        return finish(TrialState.COMPLETE, "", search.worst_case(rng()))

    def _estimating_contexts(self, number: int) -> list[tuple[Stage, dict[str, float]]]:
        if self._method.nominal:
            return [(Stage.NOMINAL, self._contexts.to_dict(self._contexts.nominal()))]
        rng = generator(self._study.seed, Stream.CONTEXTS, number)
        drawn = self._contexts.draw_stratified(self._study.budget.drawn_contexts, rng)
        return [(Stage.DRAWN, self._contexts.to_dict(row)) for row in drawn]

    def _search(self, constraint: Constraint, proposal: Proposal) -> WorstCaseSearch | JointSearch:
        if self._method.nominal:
            return WorstCaseSearch(self._contexts, constraint.upper, 0, OBSERVED)
        space = self._study.search_space()

        def to_cube(values: Mapping[str, Value]) -> Array:
            return space.to_cube({name: values[name] for name in space.names})

        if self._method.models.joint:
            kept = [t for t in self.trials if t.state is TrialState.COMPLETE]
            points = {t.number: to_cube(t.parameters) for t in kept}
            x, y = joint_observations(kept, points, self._contexts, constraint.metric)
            phi = proposal.hyperparameters.get(constraint.name)
            return JointSearch(
                self._contexts,
                constraint.upper,
                constraint.probability,
                self._study.budget.search_evaluations,
                to_cube(proposal.parameters),
                x.reshape(-1, space.dimension + self._contexts.dimension),
                y,
                None if phi is None else Hyperparameters.from_log(np.array(phi)),
            )
        known = [(t.parameters, t.worst_case) for t in self.trials if t.worst_case is not None]
        return WorstCaseSearch(
            self._contexts,
            constraint.upper,
            self._study.budget.search_evaluations,
            self._method.worst_case,
            worst_contexts_nearby(
                to_cube(proposal.parameters),
                np.array([to_cube(p) for p, _ in known]).reshape(-1, space.dimension),
                [worst for _, worst in known],
                self._contexts,
                self._method.neighbour_starts,
            ),
        )


def run_cut(
    study: Study, backend: Backend, parameters: Mapping[str, Value], planned: Evaluation
) -> Evaluation:
    """Run a planned evaluation; an objective that its scale cannot take makes it a failed one.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluation; open.
    parameters
        Value of each parameter.
    planned
        The evaluation, with no outcome yet.

    Returns
    -------
    Cut
        With its outcome, and how long it took.
    """
    begin = time.monotonic()
    outcome = backend.run_cut(study.assignments(parameters, planned.context, planned.seed))
    seconds = time.monotonic() - begin
    objective = study.objective
    if outcome.state is EvaluationState.COMPLETE and objective.scale == "log":
        value = outcome.metrics[objective.metric]
        if value <= 0.0:
            reason = f"metric {objective.metric} is {value}; its log scale needs a positive value"
            outcome = Outcome(EvaluationState.FAILED, {}, reason, outcome.details)
    return replace(planned, outcome=outcome, seconds=seconds)
