"""Observers for the advice to stop and for pauses, and the choice of the display."""

from collections.abc import Sequence

from bo_tuner.interruption import Interruption, Pause
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.stopping import StopAdvice, StopAdvisor
from bo_tuner.monitoring.display import Display, Output, plain_console
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.progress import RunProgress
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.observer import RunObserver


class Advisor(RunObserver):
    """Computes after each trial whether to advise stopping.

    Parameters
    ----------
    study
        The study.
    method
        The method of the run.
    observers
        Are passed the advice.
    """

    def __init__(self, study: Study, method: Method, observers: RunObserver) -> None:
        self._advisor = StopAdvisor(study, method)
        self._observers = observers
        self._trials: list[Trial] = []

    @property
    def advice(self) -> StopAdvice | None:
        """The advice to stop; None while there is none."""
        return self._advisor.advice

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Repeat the computations for the recorded trials, as they were without later checks."""
        for trial in trials:
            self.trial(trial.unchecked, incumbent)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Compute the advice, and pass it on if there is one."""
        self._trials.append(trial)
        advice = self._advisor.consider(self._trials)
        if advice is not None:
            self._observers.advise(advice)


class Gate(RunObserver):
    """Pauses the run between two evaluations on request, and ends it on a signal.

    It must be the last observer: the record and the displays are then complete before a pause.

    Parameters
    ----------
    interruption
        The signal; also ends a pause.
    observers
        Are passed the start and the end of a pause.

    Attributes
    ----------
    requests
        Takes the requests to pause and to continue.
    """

    def __init__(self, interruption: Interruption, observers: RunObserver) -> None:
        self._interruption = interruption
        self._observers = observers
        self.requests = Pause()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Wait while a pause is requested; raise if the run is to end."""
        self._wait()

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Wait while a pause is requested; raise if the run is to end."""
        self._wait()

    def _wait(self) -> None:
        self._interruption.check()
        if not self.requests.requested:
            return
        self._observers.pause(True)
        self.requests.wait(self._look)
        self._observers.pause(False)

    def _look(self) -> None:
        self._interruption.check()
        self._observers.waiting()


def make_display(study: Study, output: Output, status: RunStatus, going_on: str) -> Display:
    """Make the display of a run.

    Parameters
    ----------
    study
        The study.
    output
        The kind of output.
    status
        Status of the run; must receive each step before the display.
    going_on
        How a run that is paused goes on.
    """
    if output is Output.QUIET:
        return Display()
    if output is Output.JSON_LINES:
        return JsonLines(study, status)
    return RunProgress(plain_console(stderr=True), study, status, going_on)
