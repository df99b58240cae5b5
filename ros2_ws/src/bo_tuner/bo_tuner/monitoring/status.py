"""Status of a run: a snapshot after each step, which displays and topics read."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bo_tuner.evidence.verdict import Verdict
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.time_left import TimeLeft
from bo_tuner.optimizers.base import SPACE_FILLING
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Event, EventKind
from bo_tuner.study.limits import violated
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Trial,
    TrialState,
    count_evaluations,
    count_trials,
)
from bo_tuner.tuning.observer import RunObserver


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
        Estimated time [s] until the result is there; None before the first trial.
    paused
        Whether the run is paused between two evaluations.
    advice
        The advice to stop; None while there is none.
    failed, violating
        Number of trials that failed by themselves, and of complete ones that violate a constraint.
    lost
        Number of evaluations that were lost because a node stopped.
    fallbacks
        Number of trials with a space-filling proposal.
    finish
        Number of trials after which the run is to finish on request; None if nobody has asked.
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
    finish: int | None = None
    verdict: Verdict | None = None


class RunStatus(RunObserver):
    """Keeps the present snapshot, which other threads may read.

    Attributes
    ----------
    now
        The present snapshot. It is replaced as a whole, never changed.
    """

    def __init__(
        self,
        study: Study,
        method: Method,
        clock: Callable[[], float] = time.monotonic,
        workers: int = 1,
    ) -> None:
        self._study = study
        self._times = TimeLeft(study, method, clock, workers)
        # What counts for the budget.
        self._counted = self._evaluations = 0
        self._evaluation_seconds = 0.0
        self._optimizer_seconds = 0.0
        self.now = Snapshot()

    def begin(self, phase: str, total: int) -> None:
        """Set the phase."""
        self._times.begin(phase)
        self._update(phase=phase, done=0, total=total)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Count the recorded trials and their evaluations."""
        for trial in trials:
            for evaluation in trial.evaluations:
                self._count(evaluation)
            self._take(trial)
        self._times.recall(trials)
        self._update(incumbent=incumbent)

    def restart(self) -> None:
        """Let the next trial begin now."""
        self._times.begin(self.now.phase)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Count an evaluation."""
        self._times.evaluation(evaluation)
        self._count(evaluation)
        self._update()

    def advance(self) -> None:
        """Count a step that is not a trial."""
        self._update(done=self.now.done + 1)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Count a trial; its evaluations are counted before."""
        self._times.trial(trial)
        self._take(trial)
        self._update(incumbent=incumbent)

    def advise(self, advice: StopAdvice) -> None:
        """Set the advice to stop."""
        self._update(advice=advice)

    def event(self, event: Event) -> None:
        """Take a request to finish."""
        if event.kind is EventKind.FINISH:
            self.finish_after(event.tasks)

    def finish_after(self, trials: int) -> None:
        """Set the number of trials after which the run is to finish on request."""
        self._times.finish(trials)
        self._update(finish=trials, total=trials)

    def pause(self, paused: bool) -> None:
        """Set whether the run is paused."""
        self._times.pause()
        self._update(paused=paused)

    @property
    def to_finish(self) -> float | None:
        """Time [s] that the result takes at least, see `TimeLeft.to_finish`."""
        return self._times.to_finish()

    @property
    def trial_seconds(self) -> float | None:
        """Time [s] of the latest trials, on average; None before the first."""
        return self._times.of_trial()

    def expect_certificate(self, evaluations: int) -> None:
        """Set how many evaluations a certificate takes that follows the result."""
        self._times.expect_certificate(evaluations)

    @property
    def certificate_seconds(self) -> float:
        """Time [s] that they take; 0 before the first trial."""
        return self._times.of_certificate()

    def conclude(self, verdict: Verdict) -> None:
        """Set the verdict on the result."""
        self._update(verdict=verdict)

    def _count(self, evaluation: Evaluation) -> None:
        self._evaluation_seconds += evaluation.seconds
        if evaluation.outcome.state is EvaluationState.LOST:
            self._update(lost=self.now.lost + 1)

    def _take(self, trial: Trial) -> None:
        self._optimizer_seconds += trial.seconds
        failed = trial.ending == TrialState.FAILED
        complete = trial.state is TrialState.COMPLETE
        violating = complete and bool(violated(self._study, trial))
        trials, finish = self.now.trials + 1, self.now.finish
        self._counted += count_trials([trial])
        self._evaluations += count_evaluations([trial])
        self._update(
            done=self.now.done + 1,
            # Fewer trials than planned where evaluations limit them, more where some were lost.
            total=trials + self._study.budget.remaining(self._counted, self._evaluations)
            if finish is None
            else finish,
            trials=trials,
            last=trial,
            failed=self.now.failed + failed,
            violating=self.now.violating + violating,
            fallbacks=self.now.fallbacks + (trial.proposed_as == SPACE_FILLING),
        )

    def _update(self, **changes: object) -> None:
        now = replace(self.now, **changes)  # type: ignore[arg-type]
        self.now = replace(now, overhead=self._overhead(), time_left=self._times.estimate())

    def _overhead(self) -> float | None:
        busy = self._optimizer_seconds + self._evaluation_seconds
        return self._optimizer_seconds / busy if busy > 0.0 else None
