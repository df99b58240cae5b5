"""Where a run takes requests from outside: to wait, to end, or to finish a phase early."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from bo_tuner.interruption import Pause
from bo_tuner.plans import ON_REQUEST, TIME_UP, EventKind, Phase
from bo_tuner.tuning.observer import NOBODY, RunObserver
from bo_tuner.tuning.question import Question


@dataclass(frozen=True)
class Answer:
    """What somebody answers who is asked about a task.

    Attributes
    ----------
    allowed
        Whether it may be carried out.
    ends
        Whether the phase is to end.
    detail
        Who has answered, when and where, and what it was about, as JSON.
    """

    allowed: bool
    ends: bool
    detail: str


class Admission(Protocol):
    """Asks somebody whether a task may be carried out."""

    def concerns(self, task: object) -> bool:
        """Return whether it is a task to ask about."""

    def ask(self, task: Any, question: Question, wait: Callable[[], None]) -> Answer:
        """Pose the question, and wait for its answer.

        Parameters
        ----------
        task
            What it is about.
        question
            Takes the answer, from wherever it comes.
        wait
            Called again and again until it is there.
        """


class Gate:
    """Pauses the run between two evaluations on request, and ends it on a signal.

    Requests come from any thread.

    It is passed when all observers know of the evaluation: the record and the displays are complete
    before a pause.

    Attributes
    ----------
    requests
        Takes the requests to pause and to continue.
    admission
        Is asked about each task of a phase that can be refused before it begins; None if nobody
        wants to be asked.
    question
        The question about the next task, which any thread may answer.
    """

    def __init__(
        self,
        check: Callable[[], None] = lambda: None,
        observer: RunObserver = NOBODY,
        *,
        time_is_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self._check = check
        self._observer = observer
        self._halted_by = ""
        self.requests = Pause()
        self._time_is_up = time_is_up
        self._asked_to_finish = False
        self.admission: Admission | None = None
        self.question = Question()

    def admit(self, task: object) -> Answer | None:
        """Return what somebody answers about a task; None if nobody is asked about it.

        The run is paused all the while, so that the machine is parked.
        """
        if self.admission is None or not self.admission.concerns(task):
            return None
        self._check()
        self._observer.asking(True)
        answer = self.admission.ask(task, self.question, self._look)
        self.question.close()
        self._observer.asking(False)
        if answer.ends:
            self.finish()
        return answer

    def halt(self, reason: str) -> None:
        """Let the run wait because the guard has taken over, for a reason in one line."""
        self._halted_by = reason
        self.requests.request(True)

    def finish(self) -> None:
        """Ask for the end of the trials; a pause goes on all the same."""
        self._asked_to_finish = True

    def finishing(self, phase: str) -> str | None:
        """Return why a phase is to end early: `ON_REQUEST` of the trials, `TIME_UP`; else None."""
        if self._asked_to_finish and phase == Phase.TUNING:
            return ON_REQUEST
        return TIME_UP if self._time_is_up() else None

    def wait(self, note: Callable[[EventKind, str], None] = lambda kind, detail: None) -> None:
        """Wait while a pause is requested; raise if the run is to end."""
        self._check()
        reason, self._halted_by = self._halted_by, ""
        # What the guard did is noted also if somebody has let the run go on in the meantime.
        if not reason and not self.requests.requested:
            return
        note(EventKind.GUARD if reason else EventKind.PAUSE, reason)
        self._observer.pause(True)
        self.requests.wait(self._look)
        self._observer.pause(False)
        note(EventKind.CONTINUE, "")

    def _look(self) -> None:
        self._check()
        self._observer.waiting()


OPEN = Gate()
"""Never closed: nobody has its requests."""
