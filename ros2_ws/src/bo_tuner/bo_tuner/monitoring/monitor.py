"""All that watches a run, and the requests of those who watch."""

from collections.abc import Mapping, Sequence

from bo_tuner.interruption import Interruption, Pause
from bo_tuner.monitoring.display import Display, Output, plain_console
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.progress import RunProgress
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.algorithms import Method
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.stopping import StopAdvice, StopAdvisor
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, Value
from bo_tuner.tuning.observer import RunObserver


class Monitor:
    """Hands each step of a run to all observers.

    Parameters
    ----------
    study
        The study.
    method
        The algorithm of the run.
    output
        What is shown of the run.
    interruption
        Ends a pause, too.

    Attributes
    ----------
    status
        Where the run stands.
    display
        Shows it.
    pause
        To be asked for a pause.
    """

    def __init__(
        self, study: Study, method: Method, output: Output, interruption: Interruption
    ) -> None:
        self._advisor = StopAdvisor(study, method)
        self._interruption = interruption
        self.pause = Pause()
        self.status = RunStatus(study, method)
        self.display = _display(study, output, self.status)
        # The others read from the status, so it comes first.
        self._observers: list[RunObserver] = [self.status, self.display]

    @property
    def advice(self) -> StopAdvice | None:
        """The advice to stop, once it was given."""
        return self._advisor.advice

    def add(self, observer: RunObserver) -> None:
        """Tell `observer`, too, from now on."""
        self._observers.append(observer)

    def begin(self, phase: str, total: int) -> None:
        """Hand on that `total` steps of `phase` begin."""
        for observer in self._observers:
            observer.begin(phase, total)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Hand on the trials on record, and come to the advice that they led to."""
        for observer in self._observers:
            observer.recall(trials, incumbent)
        for number in range(1, len(trials) + 1):
            self._consider(trials[:number])

    def evaluation(self, evaluation: Evaluation, parameters: Mapping[str, Value]) -> None:
        """Hand on an evaluation; returns after a pause, if one is asked for."""
        for observer in self._observers:
            observer.evaluation(evaluation, parameters)
        self._wait_while_paused()

    def advance(self) -> None:
        """Hand on a step that is no trial."""
        for observer in self._observers:
            observer.advance()

    def trial(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Hand on the last of `trials`; returns after a pause, if one is asked for."""
        for observer in self._observers:
            observer.trial(trials[-1], incumbent)
        self._consider(trials)
        self._wait_while_paused()

    def _consider(self, trials: Sequence[Trial]) -> None:
        advice = self._advisor.consider(trials)
        if advice is not None:
            for observer in self._observers:
                observer.advise(advice)

    def _wait_while_paused(self) -> None:
        self._interruption.check()
        if not self.pause.requested:
            return
        for observer in self._observers:
            observer.pause(True)
        self.pause.wait(self._interruption.check)
        for observer in self._observers:
            observer.pause(False)


def _display(study: Study, output: Output, status: RunStatus) -> Display:
    if output is Output.QUIET:
        return Display()
    if output is Output.JSON_LINES:
        return JsonLines(study, status)
    return RunProgress(plain_console(stderr=True), study, status)
