"""Who looks on while a run goes on: the terminal, topics, a log."""

from collections.abc import Mapping, Sequence

from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.stopping import StopAdvice
from bo_tuner.trials import Evaluation, Trial, Value


class RunObserver:
    """Told of each step of a run, after it is on record; does nothing with it by itself.

    All calls come from the thread of the run.
    """

    def begin(self, phase: str, total: int) -> None:
        """Tell that `total` steps of `phase` begin."""

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Tell of the trials on record, which are steps, and of the best of them."""

    def evaluation(self, evaluation: Evaluation, parameters: Mapping[str, Value]) -> None:
        """Tell of an evaluation of a parameter set."""

    def advance(self) -> None:
        """Tell of a step of the phase that is no trial."""

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Tell of a trial, which is a step, and of the best one so far."""

    def advise(self, advice: StopAdvice) -> None:
        """Tell that the trials left are not worth their evaluations."""

    def pause(self, paused: bool) -> None:
        """Tell that the run waits between two evaluations, or goes on."""
