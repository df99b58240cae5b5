"""Status of a run: a snapshot after each step, which displays and topics read."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bo_tuner.optimizers.algorithms import Algorithm
from bo_tuner.optimizers.base import INITIAL, SPACE_FILLING
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.optimizers.stopping import StopAdvice
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Trial, TrialState
from bo_tuner.tuning.limits import violated
from bo_tuner.tuning.observer import Phase, RunObserver
from bo_tuner.tuning.recommendation import most_check_evaluations
from bo_tuner.tuning.settling import most_repetitions
from bo_tuner.verdict.verdict import Verdict

RECENT = 10
"""Number of latest trials that the time left is estimated from, since later trials take longer.

Their evaluations are those of the latest half, if that is more: their number differs a lot.
"""
FEWEST_FOR_A_TREND = 5
"""Number of proposals from which on their growth is estimated."""


@dataclass(frozen=True)
class Snapshot:
    """State of a run at one moment.

    Attributes
    ----------
    phase
        The present `Phase`; empty before the first.
    done, total
        Number of steps of the phase that are done, and of all.
    trials
        Number of trials so far.
    last
        The latest trial.
    incumbent
        The best trial so far, or the least violating one.
    overhead
        Share of the proposals in the time of proposals and evaluations; None before the first
        evaluation.
    time_left
        Estimated time [s] until the end of the run; None before the first trial.
    paused
        Whether the run is paused between two evaluations.
    advice
        The advice to stop; None while there is none.
    failed, violating
        Number of trials that failed, and of complete ones that violate a constraint.
    lost
        Number of evaluations that were lost because a node stopped.
    fallbacks
        Number of trials with a space-filling proposal.
    verdict
        The verdict on the result; None before the end of the run.
    """

    phase: str = ""
    done: int = 0
    total: int = 0
    trials: int = 0
    last: Trial | None = None
    incumbent: Candidate | None = None
    overhead: float | None = None
    time_left: float | None = None
    paused: bool = False
    advice: StopAdvice | None = None
    failed: int = 0
    violating: int = 0
    lost: int = 0
    fallbacks: int = 0
    verdict: Verdict | None = None


class RunStatus(RunObserver):
    """Keeps the present snapshot, which other threads may read.

    Parameters
    ----------
    study
        The study.
    algorithm
        The algorithm of the run.
    clock
        Returns the time [s] from a fixed point on.

    Attributes
    ----------
    now
        The present snapshot. It is replaced as a whole, never changed.
    """

    def __init__(
        self, study: Study, algorithm: Algorithm, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._study = study
        self._clock = clock
        self._mark = clock()
        self._evaluations = 0
        self._evaluation_seconds = 0.0
        self._optimizer_seconds = 0.0
        # Of each trial: its evaluations, all else, and whether a model proposed it.
        self._trial_times: list[tuple[float, float, bool]] = []
        self._phase_evaluations = 0
        self._algorithm = algorithm
        # Of the default and of the tuned parameter set.
        self._validation_evaluations = 2 * study.budget.validation_draws
        self.now = Snapshot()

    def begin(self, phase: str, total: int) -> None:
        """Set the phase."""
        self._phase_evaluations = 0
        self._mark = self._clock()
        self._update(phase=phase, done=0, total=total)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Count the recorded trials and their evaluations."""
        for trial in trials:
            for evaluation in trial.evaluations:
                self._count(evaluation)
            self._take(trial)
        self._phase_evaluations = 0
        self._mark = self._clock()
        self._update(incumbent=incumbent)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Count an evaluation."""
        self._count(evaluation)
        self._update()

    def advance(self) -> None:
        """Count a step that is not a trial."""
        self._update(done=self.now.done + 1)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Count a trial; its evaluations are counted before."""
        now = self._clock()
        self._take(trial, now - self._mark)
        self._mark = now
        self._update(incumbent=incumbent)

    def advise(self, advice: StopAdvice) -> None:
        """Set the advice to stop."""
        self._update(advice=advice)

    def pause(self, paused: bool) -> None:
        """Set whether the run is paused."""
        # In a pause the mark is the time that the trial has taken so far: a pause is in no trial.
        self._mark = self._clock() - self._mark
        self._update(paused=paused)

    def conclude(self, verdict: Verdict) -> None:
        """Set the verdict on the result."""
        self._update(verdict=verdict)

    def _count(self, evaluation: Evaluation) -> None:
        self._evaluations += 1
        self._phase_evaluations += 1
        self._evaluation_seconds += evaluation.seconds
        if evaluation.outcome.state is EvaluationState.LOST:
            self._update(lost=self.now.lost + 1)

    def _take(self, trial: Trial, elapsed: float = 0.0) -> None:
        """Count a trial that took `elapsed` seconds by the clock, if it was run just now."""
        self._optimizer_seconds += trial.seconds
        evaluating = sum(evaluation.seconds for evaluation in trial.evaluations)
        # Beside the proposal these are the search for the worst context and the ranking.
        other = max(trial.seconds, elapsed - evaluating)
        self._trial_times.append((evaluating, other, trial.origin != INITIAL))
        failed = trial.state is TrialState.FAILED
        violating = not failed and bool(violated(self._study, trial))
        self._update(
            done=self.now.done + 1,
            trials=self.now.trials + 1,
            last=trial,
            failed=self.now.failed + failed,
            violating=self.now.violating + violating,
            fallbacks=self.now.fallbacks + (trial.origin == SPACE_FILLING),
        )

    def _update(self, **changes: object) -> None:
        now = replace(self.now, **changes)  # type: ignore[arg-type]
        self.now = replace(now, overhead=self._overhead(), time_left=self._time_left(now))

    def _overhead(self) -> float | None:
        busy = self._optimizer_seconds + self._evaluation_seconds
        return self._optimizer_seconds / busy if busy > 0.0 else None

    def _time_left(self, now: Snapshot) -> float | None:
        if not self._trial_times:
            return None
        seconds, evaluations = 0.0, self._validation_evaluations
        if now.phase == Phase.TUNING:
            remaining = now.total - now.done
            if self._study.budget.evaluations is not None:
                left = self._study.budget.remaining(now.trials, self._evaluations)
                remaining = min(remaining, left)
            seconds = self._trials_left(remaining)
            whole = self._evaluations * (now.trials + remaining) / now.trials
            evaluations += self._checks(round(whole))
        elif now.phase == Phase.CHECKING:
            before = self._evaluations - self._phase_evaluations
            evaluations += max(0, self._checks(before) - self._phase_evaluations)
        else:
            evaluations = max(0, evaluations - self._phase_evaluations)
        return seconds + evaluations * self._evaluation_seconds / self._evaluations

    def _checks(self, evaluations: int) -> int:
        """Return the expected evaluations between trials with so many and the validation."""
        if self._algorithm.models.pooled:
            return most_repetitions(self._study, evaluations)
        # Of one candidate: usually the first one passes.
        return most_check_evaluations(self._study) if self._algorithm.most_checked else 0

    def _trials_left(self, count: int) -> float:
        """Return the estimated time [s] of so many trials to come."""
        known = len(self._trial_times)
        half = self._trial_times[-max(RECENT, known // 2) :]
        evaluating = sum(item[0] for item in half) / len(half)
        times = list(enumerate(self._trial_times))[-RECENT:]
        # A trial of the initial design says nothing of what a proposal takes.
        times = [item for item in times if item[1][2]] or times
        mean, slope = sum(item[1][1] for item in times) / len(times), 0.0
        middle = sum(item[0] for item in times) / len(times)
        if len(times) >= FEWEST_FOR_A_TREND:
            spread = sum((number - middle) ** 2 for number, _ in times)
            slope = sum((k - middle) * (time[1] - mean) for k, time in times) / spread
        ahead = known + 0.5 * (count - 1) - middle
        return count * (evaluating + mean + max(slope, 0.0) * ahead)
