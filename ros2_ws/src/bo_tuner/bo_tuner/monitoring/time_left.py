"""The time that a run will still take: what is to come times what it took lately.

These are the trials of the budget with their proposals, the evaluations that the method expects to
run for its answer, which take as long as those of trials with proposals and rankings, and the
validation. The forecast is a plain one, within a factor of two in the middle of a run: how soon the
answer is settled cannot be known, and proposals take longer with more data.
"""

from collections import deque
from collections.abc import Callable, Sequence
from statistics import fmean

from bo_tuner.methods.protocol import Method
from bo_tuner.plans import Phase
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, count_evaluations, count_trials

LATELY = 10
"""Number of latest trials, or of evaluations outside trials, that a forecast is by."""

SPARE = 1.1
"""Factor on what a result takes that is to be there in time."""


class TimeLeft:
    """Keeps the times of a run; must be called for each step when it has just ended."""

    def __init__(
        self, study: Study, method: Method, clock: Callable[[], float], workers: int = 1
    ) -> None:
        self._study = study
        self._method = method
        self._clock = clock
        self._workers = workers
        # All trials, and what counts for the budget.
        self._made = self._trials = self._evaluations = 0
        self._finish: int | None = None
        self._certificate = 0
        # Evaluations of a trial, their time, and that of the whole trial [s].
        self._lately: deque[tuple[int, float, float]] = deque(maxlen=LATELY)
        # Beside its own time, from one evaluation to the next [s]; also proposals, and the record.
        self._beside: deque[float] = deque(maxlen=LATELY)
        self.begin("")

    def begin(self, phase: str) -> None:
        """Note the beginning of a phase."""
        self._phase = phase
        self._done = 0
        # From one evaluation to the next, outside trials [s].
        self._steps: deque[float] = deque(maxlen=LATELY)
        self._trial_began = self._latest = self._clock()

    def recall(self, trials: Sequence[Trial]) -> None:
        """Take trials on record, which have the times of their proposals and evaluations only."""
        for trial in trials:
            self._take(trial.unchecked, 0.0)
        self.begin(self._phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Note an evaluation; one on record takes no time."""
        now = self._clock()
        if not evaluation.recorded:
            # The machine is warmed up once, and not ahead of each evaluation to come.
            warming = evaluation.outcome.notes.warm_up_seconds
            self._trial_began, self._latest = self._trial_began + warming, self._latest + warming
            step = now - self._latest
            self._beside.append(max(0.0, step - evaluation.seconds))
            if self._phase != Phase.TUNING:
                self._steps.append(step)
        self._done += 1
        self._latest = now

    def trial(self, trial: Trial) -> None:
        """Note a trial, after its evaluations and the ranking."""
        now = self._clock()
        self._take(trial, now - self._trial_began)
        self._trial_began = self._latest = now

    def expect_certificate(self, evaluations: int) -> None:
        """Note that a certificate follows the result, and how many evaluations it takes."""
        self._certificate = evaluations

    def finish(self, trials: int) -> None:
        """Note that the run is to end its trials after so many."""
        self._finish = trials

    def pause(self) -> None:
        """Note the beginning of a pause, or its end."""
        # In a pause the marks are times so far instead of points in time.
        now = self._clock()
        self._trial_began, self._latest = now - self._trial_began, now - self._latest

    def estimate(self) -> float | None:
        """Return the time [s] until the result, or the certificate of it, is there.

        None before the first trial.
        """
        left = self._study.budget.remaining(self._trials, self._evaluations)
        if self._finish is not None:
            left = min(left, max(0, self._finish - self._made))
        seconds = self._until_result(left)
        return None if seconds is None else seconds + self.of_certificate()

    def of_certificate(self) -> float:
        """Return the time [s] that the certificate takes; 0 before the first trial."""
        return self._certificate * self._each() / self._workers if self._lately else 0.0

    def of_trial(self) -> float | None:
        """Return the time [s] of the latest trials, on average; None before the first."""
        return fmean(seconds for _, _, seconds in self._lately) if self._lately else None

    def to_finish(self) -> float | None:
        """Return the time [s] that the result takes at least; None before the first trial.

        It is that of a run which is asked to finish: after one more trial, as one may have just
        begun, and with the runs that are expected to settle the answer; while it is settled, after
        one more of these. The validation follows in any case.
        """
        seconds = self._until_result(1, 1 if self._phase == Phase.CHECKING else None)
        return None if seconds is None else SPARE * seconds

    def _until_result(self, trials_left: int, runs_left: int | None = None) -> float | None:
        """Return the time [s] until the result is there; None before the first trial."""
        if not self._lately:
            return None
        count = sum(evaluations for evaluations, _, _ in self._lately)
        total = sum(seconds for _, _, seconds in self._lately)
        each, validating = self._each(), 2 * self._study.budget.validation_draws
        if self._phase == Phase.VALIDATION:
            return max(0, validating - self._done) * self._lately_step(each)
        trials = 0.0
        made, evaluations = self._done, self._evaluations
        if self._phase != Phase.CHECKING:
            trials = trials_left * total / len(self._lately)
            made, evaluations = 0, evaluations + round(trials_left * count / len(self._lately))
        if runs_left is None:
            runs_left = self._method.answer_evaluations(self._study, evaluations, made)
        return (
            trials
            + runs_left * self._lately_step(total / count)
            + validating * each / self._workers
        )

    def _each(self) -> float:
        """Return the time [s] of an evaluation that nothing is computed for."""
        count = sum(evaluations for evaluations, _, _ in self._lately)
        evaluating = sum(seconds for _, seconds, _ in self._lately)
        # Nothing is computed between evaluations of the validation, but they are recorded.
        return evaluating / count + min(self._beside, default=0.0)

    def _lately_step(self, otherwise: float) -> float:
        return fmean(self._steps) if self._steps else otherwise

    def _take(self, trial: Trial, seconds: float) -> None:
        count = len(trial.evaluations)
        self._made += 1
        self._trials += count_trials([trial])
        self._evaluations += count_evaluations([trial])
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        if count:
            self._lately.append((count, evaluating, max(seconds, trial.seconds + evaluating)))
