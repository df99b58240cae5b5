"""What a phase of a run is: a plan, which hands out tasks and takes their results.

The trials, the search for the answer, the validation, the parts of a certificate and the runs of
the command ``check`` are plans. One driver carries all of them out (`bo_tuner.tuning.driver`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

from bo_tuner.trials import Evaluation


class Phase(StrEnum):
    """Phases of a run."""

    TUNING = "tuning"
    CHECKING = "checking candidates"
    VALIDATION = "validation"


class EventKind(StrEnum):
    """What comes from outside while a plan is carried out."""

    FINISH = "finish"
    EXTEND = "extend"
    PAUSE = "pause"
    GUARD = "guard"
    CONTINUE = "continue"
    STANDSTILL = "standstill"
    ACCEPT = "accept"
    REFUSE = "refuse"
    ADD = "add"
    WITHDRAW = "withdraw"
    PART = "part"


ON_REQUEST = ""
"""Detail of the event that a phase finishes early, where somebody has asked for it."""
TIME_UP = "the time is up"
"""The same, where it is to finish for the time that the run was given."""


@dataclass(frozen=True)
class Event:
    """Something from outside, on record so that a resumed run repeats what came of it.

    Attributes
    ----------
    phase
        The phase in which it came.
    tasks
        Number of tasks that were planned in this phase until then, in all sessions.
    kind
        That the phase is to finish early, or to go on all the same in a later session; a
        pause, on request or because the guard had taken over, or its end; that the phase has ended
        early because its plan cannot go on; that somebody has allowed a task, or has not; that a
        run was added, a trial withdrawn, or a part of the metrics of a run told.
    detail
        More in a line: `ON_REQUEST` or `TIME_UP`, what the guard says, why the plan cannot go on,
        or as JSON who has allowed or refused which parameters, when and where, or what was added,
        withdrawn or told.
    """

    phase: str
    tasks: int
    kind: EventKind
    detail: str = ""


@dataclass(frozen=True)
class Withdrawal:
    """What somebody says of a trial: its runs say nothing of its parameters, for a reason."""

    trial: int
    reason: str


def finished_after(events: Iterable[Event], phase: Phase = Phase.TUNING) -> int | None:
    """Return the number of tasks after which a phase has none to come; None if it goes on.

    Parameters
    ----------
    events
        Of the run, in the order of the record.
    phase
        The phase, such as the trials; those after them begin anew in a run that goes on with these.
    """
    latest = _latest_end(events, phase)
    return None if latest is None else latest.tasks


def standstill_in(events: Iterable[Event]) -> str:
    """Return why the trials of a run could not go on; empty if they can, or were asked to end."""
    latest = _latest_end(events, Phase.TUNING)
    return latest.detail if latest is not None and latest.kind is EventKind.STANDSTILL else ""


def _latest_end(events: Iterable[Event], phase: Phase) -> Event | None:
    """Return the latest event that ended a phase early; None if it went on after it."""
    latest: Event | None = None
    for event in events:
        ends = event.kind in (EventKind.FINISH, EventKind.STANDSTILL) and event.phase == phase
        if ends or event.kind is EventKind.EXTEND:
            latest = event
    return None if latest is None or latest.kind is EventKind.EXTEND else latest


def finish_in(events: Iterable[Event]) -> str | None:
    """Return why the trials of a run were to finish early: `ON_REQUEST`, `TIME_UP`; else None."""
    latest = _latest_end(events, Phase.TUNING)
    return latest.detail if latest is not None and latest.kind is EventKind.FINISH else None


class Task(Protocol):
    """A parameter set with a short chain of evaluations.

    All that it needs beside its own results is fixed when it is planned, so that it depends on no
    other task that is not finished.
    """

    def ask(self) -> Evaluation | None:
        """Return the next evaluation, without an outcome; None when the task has ended.

        It is called once after the task is planned, and once after each `tell`.
        """

    def tell(self, evaluation: Evaluation) -> None:
        """Add the evaluation that was asked for, with its outcome."""


TaskT = TypeVar("TaskT", bound=Task)


class Plan(ABC, Generic[TaskT]):
    """A phase. Its state follows from what it was made with and from the results that it was told.

    Attributes
    ----------
    phase : str
        Name of the phase, for displays.
    what : str
        What its tasks are, in the plural, for messages.
    steps : int
        How many steps the phase has at most.
    attempts : int
        Runs of an evaluation that is lost or disturbed.
    standstill : str
        Why it has ended before its time of itself, with what would help; empty if it has not.
    """

    phase: str = ""
    what: str = "test runs"
    steps: int = 0
    attempts: int = 1

    @property
    def standstill(self) -> str:  # noqa: D102
        return ""

    @abstractmethod
    def ask(self, pending: Sequence[TaskT]) -> TaskT | None:
        """Return the next task.

        Parameters
        ----------
        pending
            Tasks that were planned and have no results yet, in their order.

        Returns
        -------
        Task or None
            None while something is pending: not before more is told; else: the phase has ended.
        """

    @abstractmethod
    def tell(self, task: TaskT) -> bool:
        """Take the result of a task, in the order of the tasks; returns whether it ends a step."""

    def drop(self, task: TaskT) -> None:
        """Take back the task that was planned last, of which nothing is run; it may come again."""
        raise ValueError(f"no {self.what} can be dropped")

    def refuse(self, task: TaskT) -> None:
        """Take back the task that was asked for last; it is not carried out, nor asked for again.

        Raises
        ------
        ValueError
            If no task of this plan can be refused.
        """
        raise ValueError(f"no {self.what} can be refused")

    def finish(self) -> bool:
        """Plan no more tasks on request; returns whether that ends the phase before its time."""
        return False


class Run:
    """A task of one evaluation.

    Parameters
    ----------
    planned
        The evaluation, without an outcome.

    Attributes
    ----------
    evaluation
        The evaluation; once it is run, with its outcome.
    """

    def __init__(self, planned: Evaluation) -> None:
        self.evaluation = planned
        self._waiting = True

    def ask(self) -> Evaluation | None:
        """Return the evaluation while it is not run."""
        return self.evaluation if self._waiting else None

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result."""
        self.evaluation, self._waiting = evaluation, False


class Runs(Plan[Run]):
    """A plan of evaluations that are known from the beginning.

    Parameters
    ----------
    planned
        The evaluations, in their order.
    what
        What they are, in the plural, for messages.

    Attributes
    ----------
    evaluations
        Those that were run, in their order.
    """

    def __init__(self, planned: Sequence[Evaluation], what: str = "test runs") -> None:
        self.what = what
        self.steps = len(planned)
        self._planned: Iterator[Evaluation] = iter(planned)
        self.evaluations: list[Evaluation] = []

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation as a task."""
        planned = next(self._planned, None)
        return None if planned is None else Run(planned)

    def tell(self, task: Run) -> bool:
        """Take an evaluation, which is a step."""
        self.evaluations.append(task.evaluation)
        return True


R = TypeVar("R")

Phases = Generator[Plan[Any], None, R]
"""Yields plans, each of which is carried out before the next is asked for, and returns a result."""

Batches = Generator[Sequence[Evaluation], Sequence[Evaluation], R]
"""Yields batches of planned evaluations, is sent those that were run, and returns a result."""


class BatchPlan(Plan[Run], Generic[R]):
    """A plan in batches, each chosen by the results of the one before.

    Parameters
    ----------
    batches
        Yields the batches.
    ends
        Returns whether nothing more of a batch is planned after an evaluation.

    Attributes
    ----------
    result
        What the generator has returned; None before.
    """

    def __init__(
        self, batches: Batches[R], ends: Callable[[Evaluation], bool] = lambda _: False
    ) -> None:
        self._batches = batches
        self._ends = ends
        self._unplanned: list[Evaluation] | None = None
        self._results: list[Evaluation] = []
        self._over = False
        self.result: R | None = None

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation of the batch; the next batch follows from all of it."""
        while not self._unplanned and not pending and not self._over:
            self._next_batch()
        return Run(self._unplanned.pop(0)) if self._unplanned else None

    def tell(self, task: Run) -> bool:
        """Add an evaluation, which is a step."""
        self._results.append(task.evaluation)
        if self._ends(task.evaluation):
            self._unplanned = []
        return True

    def _next_batch(self) -> None:
        try:
            if self._unplanned is None:
                self._unplanned = list(next(self._batches))
            else:
                results, self._results = self._results, []
                self._unplanned = list(self._batches.send(results))
        except StopIteration as end:
            self._over, self.result = True, end.value
