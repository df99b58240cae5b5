"""The observer for the advice to stop, and the choice of the display."""

from collections.abc import Sequence

from bo_tuner.methods.protocol import Method
from bo_tuner.methods.stopping import StopAdvice, StopAdvisor
from bo_tuner.monitoring.display import Display, Output, plain_console
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.progress import RunProgress
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.tuning.observer import RunObserver


class Advisor(RunObserver):
    """Computes after each trial whether to advise stopping."""

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


def make_display(study: Study, output: Output, status: RunStatus, going_on: str) -> Display:
    """Make the display of a run."""
    if output is Output.QUIET:
        return Display()
    if output is Output.JSON_LINES:
        return JsonLines(study, status)
    return RunProgress(plain_console(stderr=True), study, status, going_on)
