"""The tuning loop: trials of stage one, each with the evaluations of stage two."""

import time
from collections.abc import Iterator, Sequence

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.methods.protocol import Method
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Context,
    Evaluation,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
    count_evaluations,
    count_trials,
)
from bo_tuner.tuning.evaluation import Losses, evaluate
from bo_tuner.tuning.observer import NOBODY, RunObserver

ATTEMPTS = 2
"""Runs of an evaluation that is lost or disturbed; its parameters may be what ends a node."""


class Tuning:
    """The tuning loop of a study; iterating over it runs the remaining trials.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluations; open.
    method
        The method.
    observer
        Is passed each evaluation.
    trials
        Trials that an earlier session of the same run recorded.

    Attributes
    ----------
    trials
        All trials so far.
    """

    def __init__(
        self,
        study: Study,
        backend: Backend,
        method: Method,
        *,
        observer: RunObserver = NOBODY,
        trials: Sequence[Trial] = (),
    ) -> None:
        self._study = study
        self._backend = backend
        self._method = method
        self._observer = observer
        self._optimizer = method.optimizer(study)
        self._losses = Losses("trials")
        self.trials: list[Trial] = []
        for trial in trials:
            self._take(trial)

    def __iter__(self) -> Iterator[Trial]:
        """Run the remaining trials, and yield each when it has ended.

        An evaluation that was lost or disturbed is run again at once. A trial that is lost all the
        same does not use up the budget.

        Raises
        ------
        RunError
            If three trials in a row were lost with their nodes or disturbed.
        """
        budget = self._study.budget
        while not budget.is_spent(count_trials(self.trials), count_evaluations(self.trials)):
            begin = time.monotonic()
            proposal = self._optimizer.ask()
            seconds = time.monotonic() - begin
            self._observer.proposal()
            trial = self._evaluate(len(self.trials), proposal, seconds)
            self._take(trial)
            yield trial
            self._losses.check()

    def _take(self, trial: Trial) -> None:
        self.trials.append(trial)
        self._optimizer.tell(trial)
        spoilt = [e for e in trial.evaluations if e.outcome.spoilt]
        self._losses.note(spoilt[0] if spoilt else None)

    def _evaluate(self, number: int, proposal: Proposal, seconds: float) -> Trial:
        done: list[Evaluation] = []
        state, reason, worst_cases = self._stages(number, proposal, done)
        return Trial(
            number=number,
            parameters=proposal.parameters,
            origin=proposal.origin,
            state=state,
            reason=reason,
            evaluations=tuple(done),
            worst_cases=worst_cases,
            warnings=proposal.warnings,
            hyperparameters=proposal.hyperparameters,
            seconds=seconds,
        )

    def _stages(
        self, number: int, proposal: Proposal, done: list[Evaluation]
    ) -> tuple[TrialState, str, dict[str, WorstCase]]:
        """Run the evaluations of a trial until one fails, and append each to `done`."""

        def run(stage: Stage, context: Context) -> Outcome:
            seed = noise_seed(self._study.seed, Stream.NOISE, number, len(done))
            planned = Evaluation(number, len(done), stage, proposal.parameters, context, seed)
            for _ in range(ATTEMPTS):
                evaluation = evaluate(self._backend, planned, self._observer)
                if not evaluation.outcome.spoilt:
                    break
            done.append(evaluation)
            return evaluation.outcome

        def rng() -> np.random.Generator:
            return generator(self._study.seed, Stream.SEARCH, number, len(done))

        for stage, context in self._method.first_contexts(self._study, number, proposal):
            outcome = run(stage, context)
            if not outcome.complete:
                return TrialState.FAILED, outcome.reason, {}
        searches = self._method.worst_case_searches(self._study, proposal, self.trials)
        for evaluation in done:
            searches.tell(evaluation.context, evaluation.outcome.metrics)
        while not searches.done(rng()):
            context = searches.ask(rng())
            outcome = run(Stage.SEARCH, context)
            if not outcome.complete:
                return TrialState.FAILED, outcome.reason, {}
            searches.tell(context, outcome.metrics)
        return TrialState.COMPLETE, "", searches.worst_cases(rng())
