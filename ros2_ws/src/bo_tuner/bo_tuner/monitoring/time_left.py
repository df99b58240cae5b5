"""The time that a run will still take, estimated from what its trials have taken.

What is still to come until the answer is asked of the method. After it comes the validation, whose
evaluations have no search between them. All of it follows the clock, so that a change of the load
shows within some trials; a pause does not count.
"""

from collections.abc import Callable, Sequence

from bo_tuner.methods.protocol import Method
from bo_tuner.methods.times import Times
from bo_tuner.plans import Phase
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage, Trial, count_checks


class TimeLeft:
    """Keeps the times of a run; must be told of each step when it has just ended.

    Parameters
    ----------
    study, method
        Of the run.
    clock
        Returns the time [s] from a fixed point on.
    """

    def __init__(self, study: Study, method: Method, clock: Callable[[], float]) -> None:
        self._study = study
        self._method = method
        self._clock = clock
        self._times = Times()
        self.begin("")

    def begin(self, phase: str) -> None:
        """Note the beginning of a phase."""
        self._phase = phase
        self._began = self._trial_began = self._latest = self._clock()
        self._times.begin(answering=phase == Phase.CHECKING)

    def recall(self, trials: Sequence[Trial]) -> None:
        """Take trials on record, which tell the times of their proposals and evaluations only."""
        self._times.repeated += count_checks(trials)
        for trial in (checked.unchecked for checked in trials):
            self._times.evaluations += len(trial.evaluations)
            ranking = self._method.recalled_ranking(trial)
            self._times.take(trial, trial.seconds + ranking, ranking)
        self.begin(self._phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Note an evaluation."""
        now = self._clock()
        if self._phase == Phase.TUNING and evaluation.index and evaluation.stage != Stage.SEARCH:
            self._times.plain.append(max(evaluation.seconds, now - self._latest))
        self._latest = now
        self._times.evaluations += 1
        self._times.in_phase += 1
        # One on record takes no time.
        self._times.measured_in_phase += not evaluation.recorded

    def step(self) -> None:
        """Note a step of the phase that is not a trial."""
        self._times.steps += 1

    def trial(self, trial: Trial) -> None:
        """Note a trial, after its evaluations and the ranking."""
        now = self._clock()
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        other = max(trial.seconds, now - self._trial_began - evaluating)
        self._times.take(trial, other, now - self._latest)
        self._trial_began = self._latest = now

    def pause(self) -> None:
        """Note the beginning of a pause, or its end."""
        # In a pause the marks are times so far instead of points in time.
        now = self._clock()
        self._began, self._trial_began, self._latest = (
            now - mark for mark in (self._began, self._trial_began, self._latest)
        )

    def estimate(self) -> float | None:
        """Return the time [s] until the result is there; None before the first trial."""
        times = self._times
        if not times.trials:
            return None
        # In a pause the marks count from there backwards.
        times.seconds_in_phase = abs(self._latest - self._began)
        draws = 2 * self._study.budget.validation_draws
        if self._phase == Phase.VALIDATION:
            return max(0, draws - times.in_phase) * times.measured(times.plain_evaluation())
        seconds = self._method.time_to_answer(self._study, times)
        return seconds + draws * times.plain_evaluation()
