"""The trials of a run as a plan: parameter sets of stage one, each with stage two as its task."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.methods.protocol import Method
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.plans import Phase, Plan
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Context,
    Evaluation,
    Stage,
    Trial,
    TrialState,
    Value,
    WorstCase,
    count_evaluations,
    count_trials,
    ended_as,
    withdrawn,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.worst_case.constraint_searches import WorstCaseSearches

ATTEMPTS = 2
"""Runs of an evaluation that is lost or disturbed; its parameters may be what ends a node."""


class TrialTask:
    """A trial: evaluations in its first contexts, then those of the search for the worst one.

    It ends with the first evaluation that fails, is cut short or shows that the parameter set
    cannot be the answer, or as the method says.

    Attributes
    ----------
    recorded
        Whether it was on record already: False.
    """

    recorded = False

    def __init__(
        self,
        study: Study,
        method: Method,
        number: int,
        proposal: Proposal,
        trials: Sequence[Trial],
        seconds: float,
    ) -> None:
        self._study = study
        self._method = method
        self._number = number
        self._proposal = proposal
        self._known = tuple(trials)
        self._seconds = seconds
        self._first = method.first_contexts(study, number, proposal)
        if study.is_noiseless and number == 0:
            # Once more with another seed, which is to change nothing.
            self._first = [self._first[0], *self._first]
        self._searches: WorstCaseSearches | None = None
        self._done: list[Evaluation] = []

    @property
    def parameters(self) -> Mapping[str, Value]:
        """The proposed parameter set."""
        return self._proposal.parameters

    @property
    def origin(self) -> str:
        """Why it is proposed."""
        return self._proposal.origin

    def ask(self) -> Evaluation | None:
        """Return the next evaluation; None when the trial has ended."""
        done = self._done
        if done and self._ends_with(done[-1]):
            return None
        if len(done) < len(self._first):
            return self._planned(*self._first[len(done)])
        if self._searches is None:
            self._searches = self._begin_search()
        while not self._searches.done(self._rng()):
            context = self._searches.ask(self._rng())
            known = [e for e in done if e.context == context] if self._study.is_noiseless else []
            if not known:
                return self._planned(Stage.SEARCH, context)
            # Without noise another run there would be the same.
            self._searches.tell(context, known[0].outcome.metrics)
        return None

    def tell(self, evaluation: Evaluation) -> None:
        """Add an evaluation."""
        self._done.append(evaluation)
        if self._searches is not None and evaluation.outcome.complete:
            self._searches.tell(evaluation.context, evaluation.outcome.metrics)

    def trial(self) -> Trial:
        """Return the trial, once it has ended."""
        proposal = self._proposal
        failed = [e.outcome for e in self._done if not e.outcome.complete]
        state = ended_as(failed[0]) if failed else TrialState.COMPLETE
        return Trial(
            number=self._number,
            parameters=proposal.parameters,
            origin=proposal.origin,
            state=state,
            reason=failed[0].reason if failed else "",
            evaluations=tuple(self._done),
            worst_cases={} if failed else self._worst_cases(),
            warnings=proposal.warnings,
            hyperparameters=proposal.hyperparameters,
            seconds=self._seconds,
        )

    @property
    def pending(self) -> Trial:
        """What others can know of it before it has ended."""
        return pending_trial(self._study, self._method, self._number, self._proposal)

    def _ends_with(self, evaluation: Evaluation) -> bool:
        outcome = evaluation.outcome
        if not outcome.complete or self._method.ends_trial(self._study, outcome):
            return True
        hopeless = self._proposal.hopeless.beyond(evaluation.stage)
        return any(outcome.metrics[name] > most for name, most in hopeless.items())

    def _worst_cases(self) -> dict[str, WorstCase]:
        # One that ended early has not searched yet.
        searches = self._searches or self._begin_search()
        return searches.worst_cases(self._rng())

    def _begin_search(self) -> WorstCaseSearches:
        searches = self._method.worst_case_searches(self._study, self._proposal, self._known)
        for evaluation in self._done:
            searches.tell(evaluation.context, evaluation.outcome.metrics)
        return searches

    def _planned(self, stage: Stage, context: Context) -> Evaluation:
        index = len(self._done)
        seed = noise_seed(self._study.seed, Stream.NOISE, self._number, index)
        proposal, decisive = self._proposal, self._study.decisive_metrics
        hopeless = proposal.hopeless.beyond(stage)
        beyond = {name: most for name, most in hopeless.items() if name in decisive}
        return Evaluation(
            self._number, index, stage, proposal.parameters, context, seed, beyond=beyond
        )

    def _rng(self) -> np.random.Generator:
        return generator(self._study.seed, Stream.SEARCH, self._number, len(self._done))


class RecordedTask:
    """A trial on record, or one that was added, which has ended as soon as it is planned.

    Attributes
    ----------
    recorded
        Whether it was on record already.
    """

    def __init__(
        self, study: Study, method: Method, trial: Trial, *, recorded: bool = True
    ) -> None:
        self.recorded = recorded
        self._study = study
        self._method = method
        self._trial = trial

    def ask(self) -> None:
        """Return None: nothing is to be run."""

    def tell(self, evaluation: Evaluation) -> None:
        """Take nothing."""
        raise ValueError(f"{evaluation.place} is on record")

    def trial(self) -> Trial:
        """Return the trial."""
        return self._trial

    @property
    def pending(self) -> Trial:
        """What others could know of it before it had ended."""
        trial = self._trial
        proposal = Proposal(dict(trial.parameters), trial.origin)
        return pending_trial(self._study, self._method, trial.number, proposal)


def pending_trial(study: Study, method: Method, number: int, proposal: Proposal) -> Trial:
    """Return a trial that has not ended, with planned evaluations in its first contexts.

    The contexts are those of any trial of its number, also where a proposal asks for fewer: that is
    not on record, and a resumed run has to know the same.
    """
    contexts = method.first_contexts(study, number, replace(proposal, protocol=None))
    evaluations = tuple(
        Evaluation(number, index, stage, proposal.parameters, context, 0)
        for index, (stage, context) in enumerate(contexts)
    )
    state = TrialState.FAILED
    return Trial(number, proposal.parameters, proposal.origin, state, "pending", evaluations)


def trials_are_over(study: Study, trials: Sequence[Trial], finished: int | None) -> bool:
    """Return whether no trial is to come: the budget is spent, or the run was asked to finish."""
    if finished is not None and len(trials) >= finished:
        return True
    return study.budget.is_spent(count_trials(trials), count_evaluations(trials))


AddedTrial = Callable[[int, Sequence[Trial]], Trial]
"""Makes a trial of runs that somebody else has made, by its number and the trials before it."""


class TrialPlan(Plan[TrialTask | RecordedTask]):
    """The trials of a study, up to its budget.

    Those that are pending are known to stage one, and are counted as if none was lost.

    Attributes
    ----------
    trials
        Those that have ended.
    """

    phase = Phase.TUNING
    what = "trials"
    attempts = ATTEMPTS

    def __init__(
        self,
        study: Study,
        method: Method,
        recorded: Sequence[Trial] = (),
        finished: int | None = None,
        refused: Iterable[Mapping[str, Value]] = (),
    ) -> None:
        self._study = study
        self._method = method
        self._recorded = tuple(recorded)
        self._finished = finished
        self._refused = [dict(parameters) for parameters in refused]
        self._added: list[tuple[int, AddedTrial]] = []
        self._planned = 0
        self.steps = study.budget.trials
        self.trials: list[Trial] = []
        self._optimizer = self._informed()

    def _informed(self) -> Optimizer:
        """Return an optimizer that knows all trials that have ended, and what was refused."""
        optimizer = self._method.optimizer(self._study)
        for parameters in self._refused:
            optimizer.refuse(parameters)
        for trial in self.trials:
            optimizer.tell(trial)
        return optimizer

    def add(self, number: int, added: AddedTrial) -> None:
        """Take a trial that somebody else has made as the next one from a number on."""
        self._added.append((number, added))

    def withdraw(self, number: int, reason: str) -> None:
        """Take from a trial that has ended what its runs say of its parameters."""
        self.trials[number] = withdrawn(self.trials[number], reason)
        self._optimizer = self._informed()

    def finish(self) -> bool:
        """Plan no more trials; those that are pending are run to their end."""
        if self._finished is not None:
            return False
        self._finished = self._planned
        return True

    def ask(self, pending: Sequence[TrialTask | RecordedTask]) -> TrialTask | RecordedTask | None:
        """Propose the next trial."""
        number = self._planned = len(self.trials) + len(pending)
        if number < len(self._recorded):
            self._planned += 1
            return RecordedTask(self._study, self._method, self._recorded[number])
        if self._added and number >= self._added[0][0]:
            self._planned += 1
            _, made = self._added.pop(0)
            trial = made(number, self.trials)
            return RecordedTask(self._study, self._method, trial, recorded=False)
        planned = [task.pending for task in pending]
        trials = count_trials(self.trials) + len(planned)
        evaluations = count_evaluations(self.trials) + sum(len(t.evaluations) for t in planned)
        if self._study.budget.is_spent(trials, evaluations):
            return None
        if self._finished is not None and number >= self._finished:
            return None
        begin = time.monotonic()
        proposal = self._optimizer.ask(planned)
        seconds = time.monotonic() - begin
        if proposal is None:
            return None
        self._planned += 1
        return TrialTask(self._study, self._method, number, proposal, self.trials, seconds)

    def refuse(self, task: TrialTask | RecordedTask) -> None:
        """Take back a trial; another parameter set is proposed in its place."""
        if isinstance(task, TrialTask):
            self._planned -= 1
            self._refused.append(dict(task.parameters))
            self._optimizer.refuse(task.parameters)

    def drop(self, task: TrialTask | RecordedTask) -> None:
        """Take back a trial; what is proposed in its place may be the same."""
        self._planned -= 1

    @property
    def standstill(self) -> str:  # noqa: D102
        return self._optimizer.standstill

    def tell(self, task: TrialTask | RecordedTask) -> bool:
        """Add a trial; observers are notified of it as a trial and not as a step."""
        trial = task.trial()
        self.trials.append(trial)
        self._optimizer.tell(trial)
        return False


class Tuning:
    """The trials of a study; iterating over it runs those that remain.

    Attributes
    ----------
    plan
        The plan.
    """

    def __init__(
        self,
        study: Study,
        driver: Driver,
        method: Method,
        *,
        trials: Sequence[Trial] = (),
        finished: int | None = None,
        refused: Iterable[Mapping[str, Value]] = (),
    ) -> None:
        self.plan = TrialPlan(study, method, trials, finished, refused)
        self._driver = driver
        self._recorded = trials

    @property
    def trials(self) -> Sequence[Trial]:
        """All trials so far, those on record included."""
        return self.plan.trials or self._recorded

    def __iter__(self) -> Iterator[Trial]:
        """Run the remaining trials, and yield each when it has ended.

        A trial whose evaluation was lost twice, or disturbed, does not use up the budget.
        """
        for task in self._driver.run(self.plan):
            if not task.recorded:
                yield self.plan.trials[-1]
