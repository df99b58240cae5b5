"""Interface of the observers of a run: journal, recording, displays and topics."""

from collections.abc import Sequence

from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Event
from bo_tuner.trials import Evaluation, Trial


class RunObserver:
    """Callbacks for the steps of a run; each does nothing unless it is overridden.

    All are called from the thread of the run.
    """

    def begin(self, phase: str, total: int) -> None:
        """Handle the start of a phase, which has `total` steps."""

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Handle the recorded trials of a resumed run, each a step, and their incumbent."""

    def planned(self, phase: str) -> None:
        """Handle that the next task of a phase, such as a trial, is planned; evaluations follow."""

    def evaluation(self, evaluation: Evaluation) -> None:
        """Handle a finished evaluation, before its result is used."""

    def advance(self) -> None:
        """Handle a step of the phase that is not a trial."""

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Handle a finished trial, which is a step, and the incumbent after it."""

    def end(self, phase: str) -> None:
        """Handle the end of a phase, after all its steps."""

    def advise(self, advice: StopAdvice) -> None:
        """Handle the advice to stop."""

    def event(self, event: Event) -> None:
        """Handle a request from outside, before anything follows from it."""

    def pause(self, paused: bool) -> None:
        """Handle the start of a pause between two evaluations, or its end."""

    def asking(self, asked: bool) -> None:
        """Handle that somebody is asked about the next task, or has answered: it is a pause."""
        self.pause(asked)

    def waiting(self) -> None:
        """Handle that a pause lasts; called again and again."""


NOBODY = RunObserver()


class Observers(RunObserver):
    """Passes each step on to several observers, in the order in which they were added."""

    def __init__(self) -> None:
        self._observers: list[RunObserver] = []

    def add(self, observer: RunObserver) -> None:
        """Pass all further steps on to `observer` as well."""
        self._observers.append(observer)

    def begin(self, phase: str, total: int) -> None:
        """Pass on the start of a phase."""
        for observer in self._observers:
            observer.begin(phase, total)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Pass on the recorded trials."""
        for observer in self._observers:
            observer.recall(trials, incumbent)

    def planned(self, phase: str) -> None:
        """Pass on that a task is planned."""
        for observer in self._observers:
            observer.planned(phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Pass on an evaluation."""
        for observer in self._observers:
            observer.evaluation(evaluation)

    def advance(self) -> None:
        """Pass on a step that is not a trial."""
        for observer in self._observers:
            observer.advance()

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Pass on a trial."""
        for observer in self._observers:
            observer.trial(trial, incumbent)

    def end(self, phase: str) -> None:
        """Pass on the end of a phase."""
        for observer in self._observers:
            observer.end(phase)

    def advise(self, advice: StopAdvice) -> None:
        """Pass on the advice to stop."""
        for observer in self._observers:
            observer.advise(advice)

    def event(self, event: Event) -> None:
        """Pass on a request from outside."""
        for observer in self._observers:
            observer.event(event)

    def pause(self, paused: bool) -> None:
        """Pass on a pause or its end."""
        for observer in self._observers:
            observer.pause(paused)

    def asking(self, asked: bool) -> None:
        """Pass on a question, or that it was answered."""
        for observer in self._observers:
            observer.asking(asked)

    def waiting(self) -> None:
        """Pass on that a pause lasts."""
        for observer in self._observers:
            observer.waiting()
