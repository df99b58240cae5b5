"""What is to fit into the time of a run: trials, answer, validation, and a certificate after it."""

import time
from collections.abc import Callable, Iterator

from bo_tuner.cli.time_limit import TimeLimit
from bo_tuner.evidence.certificate.outlook import Outlook, probable_certificate
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Phase
from bo_tuner.study.study import Study
from bo_tuner.text import counted, duration, durations
from bo_tuner.trials import Trial
from bo_tuner.tuning.observer import RunObserver

MOST_OF_CERTIFICATE = 0.5
"""Part of the time that is kept for a certificate, at most: a poor result is not worth one."""

NAMES = {
    Phase.TUNING: "trials",
    Phase.CHECKING: "settling the answer",
    Phase.VALIDATION: "validation",
}


class TimePlan(RunObserver):
    """Tells when a run has to finish, what is expected to fit, and what the time went to."""

    def __init__(
        self,
        study: Study,
        status: RunStatus,
        limit: TimeLimit,
        inform: Callable[[str], None],
        *,
        certify: bool,
    ) -> None:
        self._study = study
        self._status = status
        self._limit = limit
        self._inform = inform
        self._certify = certify
        self._certificate: Outlook | None = None
        self._seconds: dict[str, float] = {}
        self._began = 0.0
        if certify:
            self._price(None)

    @property
    def has_to_finish(self) -> bool:
        """Whether no more can be begun if the result is to be there in time."""
        return self._limit.left <= (self._status.to_finish or 0.0) + self._kept

    @property
    def _kept(self) -> float:
        """Time [s] that is kept for the certificate."""
        return min(self._status.certificate_seconds, MOST_OF_CERTIFICATE * self._limit.seconds)

    def _price(self, best: Candidate | None) -> None:
        """Estimate what the certificate takes, by what is known of the best set so far."""
        known = {} if best is None else best.trial.worst_cases
        self._certificate = probable_certificate(self._study, known)
        high = 0 if self._certificate is None else self._certificate.high
        self._status.expect_certificate(high)

    def begin(self, phase: str, total: int) -> None:
        """Note when a phase begins."""
        self._began = time.monotonic()

    def end(self, phase: str) -> None:
        """Note how long it took."""
        self._seconds[phase] = time.monotonic() - self._began

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Take what is known of the best by now, and after the initial design tell what fits."""
        if self._limit.endless:
            return
        if self._certify:
            self._price(incumbent)
        if self._status.now.trials == self._study.budget.initial_trials:
            self._inform(f"in the time that is left: {', '.join(self._expected())}")

    def _expected(self) -> Iterator[str]:
        left, trial = self._limit.left, self._status.trial_seconds
        result = self._status.to_finish
        if result is None or trial is None:
            return
        most = int(max(0.0, left - result - self._kept) / trial) if trial > 0.0 else 0
        most = min(most, max(0, self._status.now.total - self._status.now.trials))
        yield f"about {counted(most, 'more trial')}"
        yield f"{duration(result)} for the answer and its validation"
        if not self._certify:
            return
        if self._certificate is None:
            yield "what is left then for a certificate, which hardly ever passes by what is known"
            return
        each = self._status.certificate_seconds / max(self._certificate.high, 1)
        low, high = each * self._certificate.low, self._status.certificate_seconds
        part = f", of which {duration(self._kept)} are kept" if self._kept < high else ""
        yield (
            f"a certificate of probably {self._certificate} runs, {durations(low, high)}, if it "
            f"passes{part}"
        )

    @property
    def outcome(self) -> str:
        """What the time went to, in a line; empty without a limit."""
        if self._limit.endless:
            return ""
        parts = [
            f"{NAMES[Phase(phase)]} {duration(seconds)}" for phase, seconds in self._seconds.items()
        ]
        return f"{self._limit.outcome}: {', '.join(parts)}"
