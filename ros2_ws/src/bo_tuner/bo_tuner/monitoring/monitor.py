"""What watches a run besides its screens: the advice to stop, and the requests to wait."""

from collections.abc import Sequence

from bo_tuner.interruption import Interruption, Pause
from bo_tuner.monitoring.display import Display, Output, plain_console
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.progress import RunProgress
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.algorithms import Algorithm
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.stopping import StopAdvice, StopAdvisor
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.observer import RunObserver


class Advisor(RunObserver):
    """Asks after each trial whether the ones left are worth their evaluations.

    Parameters
    ----------
    study
        The study.
    algorithm
        The algorithm of the run.
    observers
        Told of the advice.
    """

    def __init__(self, study: Study, algorithm: Algorithm, observers: RunObserver) -> None:
        self._advisor = StopAdvisor(study, algorithm)
        self._observers = observers
        self._trials: list[Trial] = []

    @property
    def advice(self) -> StopAdvice | None:
        """The advice to stop, once it was given."""
        return self._advisor.advice

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Come to the advice that the trials on record led to."""
        for trial in trials:
            self.trial(trial, incumbent)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Ask, and pass on the advice."""
        self._trials.append(trial)
        advice = self._advisor.consider(self._trials)
        if advice is not None:
            self._observers.advise(advice)


class Gate(RunObserver):
    """Holds the run between two evaluations while a pause is asked for, and ends it on a signal.

    It comes last in the list of observers: what is on record and on screens is complete then.

    Parameters
    ----------
    interruption
        Ends a pause, too.
    observers
        Told of a pause.

    Attributes
    ----------
    requests
        To be asked for a pause.
    """

    def __init__(self, interruption: Interruption, observers: RunObserver) -> None:
        self._interruption = interruption
        self._observers = observers
        self.requests = Pause()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Let the run continue, at once or after a pause."""
        self._wait()

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Let the run continue, at once or after a pause."""
        self._wait()

    def _wait(self) -> None:
        self._interruption.check()
        if not self.requests.requested:
            return
        self._observers.pause(True)
        self.requests.wait(self._interruption.check)
        self._observers.pause(False)


def make_display(study: Study, output: Output, status: RunStatus) -> Display:
    """Make what shows the run in the terminal.

    Parameters
    ----------
    study
        The study.
    output
        What to show.
    status
        Where the run stands, told of each step before the display.
    """
    if output is Output.QUIET:
        return Display()
    if output is Output.JSON_LINES:
        return JsonLines(study, status)
    return RunProgress(plain_console(stderr=True), study, status)
