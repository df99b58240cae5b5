"""Carries out plans: has their tasks run, notifies observers, counts losses, waits and ends.

With a window of q tasks, task k is planned when exactly the tasks up to k - q are told, even if
later results are there, and those in between are pending. So what is asked and told is one fixed
sequence for given q, in whatever order results come; those that come early wait.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Generic

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import BackendError, RunError
from bo_tuner.plans import Event, EventKind, Plan, Runs, TaskT
from bo_tuner.trials import Evaluation
from bo_tuner.tuning.gate import OPEN, Gate
from bo_tuner.tuning.losses import Attempts, Losses
from bo_tuner.tuning.observer import NOBODY, RunObserver


class Driver:
    """Carries out one plan after the other."""

    def __init__(
        self,
        backend: Backend,
        observer: RunObserver = NOBODY,
        *,
        window: int = 1,
        gate: Gate = OPEN,
    ) -> None:
        self._backend = backend
        self._observer = observer
        self._window = window
        self._gate = gate

    def complete(self, plan: Plan[TaskT]) -> None:
        """Carry out a plan as a phase of the run, from its beginning to its end."""
        self._observer.begin(plan.phase, plan.steps)
        for _ in self.run(plan):
            pass
        self._observer.end(plan.phase)

    def evaluate(self, planned: Evaluation) -> Evaluation:
        """Run a single evaluation."""
        (task,) = self.run(Runs([planned]))
        return task.evaluation

    def run(self, plan: Plan[TaskT]) -> Iterator[TaskT]:
        """Carry out a plan; yields each task when the plan was told of it, in their order.

        An evaluation that came to nothing is run again at once, see `Attempts`.
        """
        steps = Steps(plan, self._observer, window=self._window, gate=self._gate)
        yield from steps.begin()
        try:
            while not steps.over:
                ran = False
                for evaluation in self._backend.run(steps.due()):
                    ran = True
                    yield from steps.take(evaluation)
                if not steps.over and not ran:
                    raise BackendError("the backend has given no result")
        except BackendError as error:
            # Nodes that cannot be had are bad input; those that are gone since are not.
            raise RunError(str(error)) from error


class Steps(Generic[TaskT]):
    """A plan on its way, for whoever runs the evaluations: what is due, and what comes of it.

    `begin` comes first, and each generator is run to its end before the next call.
    """

    def __init__(
        self,
        plan: Plan[TaskT],
        observer: RunObserver = NOBODY,
        *,
        window: int = 1,
        gate: Gate = OPEN,
    ) -> None:
        self._plan = plan
        self._observer = observer
        self._gate = gate
        self._losses = Losses(plan.what)
        self._window = _Window(plan, window, observer)

    @property
    def over(self) -> bool:
        """Whether the plan has come to its end."""
        return not self._window.tasks

    def begin(self) -> Iterator[TaskT]:
        """Plan the first tasks, or more; yields those that have nothing to run, as `take` does."""
        self._fill()
        yield from self._tell()

    def due(self) -> Iterator[Evaluation]:
        """Yield what can be run now, of the oldest task first; pulled when there is room for it."""
        return self._window.due()

    def take(self, evaluation: Evaluation) -> Iterator[TaskT]:
        """Take the result of an evaluation; yields tasks as the plan is told of them."""
        evaluation = self._window.judged(evaluation)
        self._observer.evaluation(evaluation)
        self._pass_gate()
        self._window.take(evaluation)
        yield from self._tell()

    def take_back(self) -> int:
        """Take back what nobody runs yet, for `begin` to plan anew; returns how many tasks stay."""
        self._window.drop_unbegun()
        return self._window.planned

    def _tell(self) -> Iterator[TaskT]:
        """Tell the plan of the tasks that have ended, and yield them, up to one that has not."""
        while (ended := self._window.ended()) is not None:
            self._losses.note(ended.lost)
            if self._plan.tell(ended.task):
                self._observer.advance()
            yield ended.task
            self._pass_gate()
            self._losses.check()
            self._fill()

    def _fill(self) -> None:
        """Plan what can be planned; an observer is told if the plan cannot go on."""
        self._window.fill(self._admit)
        if self.over and self._plan.standstill:
            self._note(EventKind.STANDSTILL, self._plan.standstill)

    def _admit(self, task: TaskT) -> bool:
        """Return whether a task may be carried out; the answer of whoever is asked is an event."""
        answer = self._gate.admit(task)
        if answer is not None:
            self._note(EventKind.ACCEPT if answer.allowed else EventKind.REFUSE, answer.detail)
        if answer is None or answer.allowed:
            return True
        self._plan.refuse(task)
        if answer.ends and self._plan.finish():
            self._note(EventKind.FINISH)
        return False

    def _pass_gate(self) -> None:
        """Take requests from outside, and pass them to observers as events."""
        self._gate.wait(self._note)
        why = self._gate.finishing(self._plan.phase)
        if why is not None and self._plan.finish():
            self._note(EventKind.FINISH, why)

    def _note(self, kind: EventKind, detail: str = "") -> None:
        self._observer.event(Event(self._plan.phase, self._window.planned, kind, detail))


class _Planned(Generic[TaskT]):
    """A task that the plan is not told of yet.

    Attributes
    ----------
    task
        The task.
    next
        Its next evaluation; None when it has ended.
    running
        Whether a backend has it.
    begun
        Whether a backend has, or had, one of its evaluations.
    lost
        The first of its evaluations that is unusable, if there is one.
    """

    def __init__(self, task: TaskT, attempts: int) -> None:
        self.task = task
        self.next = task.ask()
        self.running = self.begun = False
        self.lost: Evaluation | None = None
        self._attempts = Attempts(attempts)

    def judged(self, evaluation: Evaluation) -> Evaluation:
        """Return a result, with what the runs before it make of it."""
        return replace(evaluation, outcome=self._attempts.judged(evaluation.outcome))

    def take(self, evaluation: Evaluation) -> None:
        """Take a result, unless its evaluation is to be run again."""
        self.running = False
        if self._attempts.is_due_again(evaluation.outcome):
            return
        if evaluation.outcome.unusable and self.lost is None:
            self.lost = evaluation
        self.task.tell(evaluation)
        self.next = self.task.ask()


class _Window(Generic[TaskT]):
    """The tasks that are planned and not told, the oldest first.

    Attributes
    ----------
    tasks
        Those tasks.
    planned
        Number of all tasks of the plan that were planned, the told ones included.
    """

    def __init__(self, plan: Plan[TaskT], size: int, observer: RunObserver) -> None:
        self._plan = plan
        self._size = size
        self._observer = observer
        self.tasks: deque[_Planned[TaskT]] = deque()
        self.planned = 0

    def fill(self, admit: Callable[[TaskT], bool]) -> None:
        """Plan tasks until the window is full or the plan has none now.

        `admit` returns whether a task may be carried out; another one is asked for in place of one
        that may not.
        """
        while len(self.tasks) < self._size:
            task = self._plan.ask([planned.task for planned in self.tasks])
            if task is None:
                return
            if not admit(task):
                continue
            planned = _Planned(task, self._plan.attempts)
            self.tasks.append(planned)
            self.planned += 1
            if planned.next is not None:
                self._observer.planned(self._plan.phase)

    def drop_unbegun(self) -> None:
        """Take back the latest tasks, up to one that has begun, or has ended without a run."""
        while self.tasks and not (last := self.tasks[-1]).begun and last.next is not None:
            self._plan.drop(self.tasks.pop().task)
            self.planned -= 1

    def due(self) -> Iterator[Evaluation]:
        """Yield what can be run now, of the oldest task first; pulled when there is room for it."""
        while (planned := self._waiting()) is not None:
            planned.running = planned.begun = True
            if planned.next is not None:
                yield planned.next

    def _waiting(self) -> _Planned[TaskT] | None:
        waiting = (p for p in self.tasks if p.next is not None and not p.running)
        return next(waiting, None)

    def judged(self, evaluation: Evaluation) -> Evaluation:
        """Return a result, with what earlier runs of the same make of it."""
        return self._awaiting(evaluation).judged(evaluation)

    def take(self, evaluation: Evaluation) -> None:
        """Give a result to its task."""
        self._awaiting(evaluation).take(evaluation)

    def _awaiting(self, evaluation: Evaluation) -> _Planned[TaskT]:
        for planned in self.tasks:
            awaited = planned.next if planned.running else None
            if awaited is not None and _place(awaited) == _place(evaluation):
                return planned
        raise BackendError(f"the backend has run {evaluation.place}, which was not asked for")

    def ended(self) -> _Planned[TaskT] | None:
        """Take the oldest task out if it has ended."""
        if self.tasks and self.tasks[0].next is None:
            return self.tasks.popleft()
        return None


def _place(evaluation: Evaluation) -> tuple[object, ...]:
    """Return the key of an evaluation among those that are planned."""
    return evaluation.stage, evaluation.trial, evaluation.index, evaluation.seed
