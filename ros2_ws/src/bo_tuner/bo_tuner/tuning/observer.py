"""Who is told of a run while it goes on: the journal, the recording, screens and topics."""

from collections.abc import Sequence
from enum import StrEnum

from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.stopping import StopAdvice
from bo_tuner.trials import Evaluation, Trial


class Phase(StrEnum):
    """Phases of a run."""

    TUNING = "tuning"
    CHECKING = "checking candidates"
    VALIDATION = "validation"


class RunObserver:
    """Told of each step of a run; does nothing with it by itself.

    All calls come from the thread of the run.
    """

    def begin(self, phase: str, total: int) -> None:
        """Take note that `total` steps of `phase` begin."""

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Take note of the trials on record, which are steps, and of the best of them."""

    def evaluation(self, evaluation: Evaluation) -> None:
        """Take note of an evaluation, before anything builds on it."""

    def advance(self) -> None:
        """Take note of a step of the phase that is no trial."""

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Take note of a trial, which is a step, and of the best one so far."""

    def end(self, phase: str) -> None:
        """Take note that all steps of `phase` were made."""

    def advise(self, advice: StopAdvice) -> None:
        """Take note that the trials left are not worth their evaluations."""

    def pause(self, paused: bool) -> None:
        """Take note that the run waits between two evaluations, or continues."""


NOBODY = RunObserver()


class Observers(RunObserver):
    """Passes each step on to a list of observers, in its order.

    Parameters
    ----------
    *observers
        The first ones; `add` appends others.
    """

    def __init__(self, *observers: RunObserver) -> None:
        self._observers = list(observers)

    def add(self, observer: RunObserver) -> None:
        """Tell `observer`, too, from now on."""
        self._observers.append(observer)

    def begin(self, phase: str, total: int) -> None:
        """Pass on that a phase begins."""
        for observer in self._observers:
            observer.begin(phase, total)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Pass on the trials on record."""
        for observer in self._observers:
            observer.recall(trials, incumbent)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Pass on an evaluation."""
        for observer in self._observers:
            observer.evaluation(evaluation)

    def advance(self) -> None:
        """Pass on a step that is no trial."""
        for observer in self._observers:
            observer.advance()

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Pass on a trial."""
        for observer in self._observers:
            observer.trial(trial, incumbent)

    def end(self, phase: str) -> None:
        """Pass on that a phase has ended."""
        for observer in self._observers:
            observer.end(phase)

    def advise(self, advice: StopAdvice) -> None:
        """Pass on the advice to stop."""
        for observer in self._observers:
            observer.advise(advice)

    def pause(self, paused: bool) -> None:
        """Pass on a pause or its end."""
        for observer in self._observers:
            observer.pause(paused)
