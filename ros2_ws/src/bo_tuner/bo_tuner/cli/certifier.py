"""Makes the certificate of one parameter set of a run, and shows how far it is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean

from rich.console import Console

from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.cli.common import opened
from bo_tuner.cli.time_limit import TimeLimit
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.certification import Certification, most_evaluations
from bo_tuner.evidence.certificate.making import make_certificate
from bo_tuner.evidence.certificate.outlook import Outlook, outlook
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.subjects import subjects_of
from bo_tuner.evidence.certificate.unfinished import Unfinished
from bo_tuner.evidence.certificate_file import write_certificate
from bo_tuner.evidence.words.facts import failed_on
from bo_tuner.evidence.words.so_far import so_far
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.certificate_progress import CertificateProgress
from bo_tuner.numerics.sequential import spent
from bo_tuner.recording.abort_bags import AbortBags
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.terminal import print_line
from bo_tuner.text import counted, durations
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.observer import Observers, RunObserver


class UndecidedError(Exception):
    """The time has ended before a verdict.

    Attributes
    ----------
    shown
        What is shown until now, in lines.
    """

    def __init__(self, shown: Sequence[str]) -> None:
        super().__init__("the time has ended before a verdict")
        self.shown = shown


@dataclass(frozen=True)
class Certifier:
    """Certifies parameter sets of a run.

    Attributes
    ----------
    record
        Of the run.
    folder
        Of the run, open.
    make_nodes
        Makes the backend of one certificate.
    confidence
        Of all certificates of the run together.
    interruption
        Ends the evaluations.
    console
        Shows how far they are.
    with_default
        Whether the default is certified, too, in the same draws.
    more
        Whether another certificate may follow in this call.
    window
        Number of evaluations that are planned at once.
    time
        After which no more of them are begun.
    """

    record: RunRecord
    folder: RunFolder
    make_nodes: Callable[[], Backend]
    confidence: float
    interruption: Interruption
    console: Console
    with_default: bool
    more: bool
    window: int = 1
    time: TimeLimit = field(default_factory=TimeLimit)

    def certify(
        self, trial: Trial, draws: int, attempt: int, best_sha256: str | None
    ) -> tuple[Certificate, Path, list[str]]:
        """Run all evaluations of a trial's parameter set, and write its certificate."""
        study, folder = self.record.study, self.folder
        nodes = self.make_nodes()
        if isinstance(nodes, RosBackend):
            nodes.at_abort = AbortBags(folder.path, study, self.console.print)
        subjects = subjects_of(self.record, trial, nodes.name, with_default=self.with_default)
        self._show_earlier(subjects)
        confidence = spent(self.confidence, attempt, len(subjects))
        self._show_most(subjects, draws)
        probable = outlook(study, draws, confidence, subjects[-1].earlier.drawn, trial.worst_cases)
        left = _Left(self.record, probable, len(subjects))
        left.show(self.console)
        unfinished = Unfinished(folder.path, study, trial.parameters, nodes.name, attempt)
        if unfinished.evaluations:
            done = counted(len(unfinished.evaluations), "test run")
            self.console.print(
                f"continuing the interrupted certificate of trial {trial.number} after {done}"
            )
        backend = RecordedEvaluations(nodes, study, unfinished.evaluations)
        try:
            shown, observers = CertificateProgress(self.console, left.words), Observers()
            observers.add(unfinished)
            observers.add(left)
            observers.add(shown)
            gate = Gate(self.interruption.check, observers, time_is_up=lambda: self.time.over)
            certification = Certification(
                study,
                Driver(backend, observers, window=self.window, gate=gate),
                confidence=confidence,
                attempt=attempt,
                finishing=lambda: self.time.over,
            )
            with opened(backend, self.interruption, again=self.more) as unrestored, shown:
                collected = certification.collect(subjects, draws)
        finally:
            unfinished.close()
        if certification.cut_short:
            raise UndecidedError(
                [
                    f"{subject.name}: {line}" if len(subjects) > 1 else line
                    for subject, item in zip(subjects, collected, strict=True)
                    for line in so_far(study, item, confidence)
                ]
            )
        evidence = {subject.name: item for subject, item in zip(subjects, collected, strict=True)}
        certificate = make_certificate(
            self.record,
            trial,
            evidence,
            draws,
            self.confidence,
            attempt,
            nodes.name,
            best_sha256,
        )
        folder.check()
        path = write_certificate(folder.path, study, certificate, evidence)
        unfinished.remove()
        return certificate, path, unrestored

    def _show_earlier(self, subjects: Sequence[Subject]) -> None:
        """Say what failed before, and where it is evaluated again."""
        for subject in subjects:
            for refutation in subject.earlier.refutations:
                count = len(refutation.contexts)
                failed = f"{counted(count, 'context')} that failed {'are' if count > 1 else 'is'}"
                again = f"its {failed} run again, and " if count else ""
                what = f"{subject.name}: {failed_on(refutation)}"
                line = f"{what}; {again}its runs count against a PASS"
                print_line(self.console, line, "  ")

    def _show_most(self, subjects: Sequence[Subject], draws: int) -> None:
        """Say how many evaluations it takes at most."""
        most = most_evaluations(self.record.study, subjects, draws)
        parts = [f"{most.drawn} at random"]
        if most.searched:
            parts.append(f"{most.searched} to search for the worst contexts")
        if most.repeated:
            parts.append(f"{most.repeated} in the worst contexts found")
        print_line(
            self.console,
            f"at most {most.total} test runs ({', '.join(parts)}), fewer once the verdict is clear",
            "  ",
        )


class _Left(RunObserver):
    """What a certificate probably still takes, by what its evaluations took until now."""

    def __init__(self, record: RunRecord, probable: Outlook | None, subjects: int) -> None:
        self._probable = probable
        self._subjects = subjects
        complete = [e.seconds for e in record.evaluations if e.outcome.complete]
        self._each = fmean(complete) if complete else 0.0
        self._done = 0

    def show(self, console: Console) -> None:
        """Say how many evaluations it probably takes."""
        if self._probable is None:
            return
        each = " each" if self._subjects > 1 else ""
        console.print(
            f"probably {self._probable} test runs{each}, {self._times()}, by the margins of the "
            "run, if it passes",
            soft_wrap=True,
        )

    def evaluation(self, evaluation: Evaluation) -> None:
        self._done += 1

    def words(self) -> str:
        """Return the time that is probably left; empty where that is not known."""
        if self._probable is None or self._done >= self._subjects * self._probable.high:
            return ""
        return f"probably {self._times()} left"

    def _times(self) -> str:
        if self._probable is None:
            return ""
        ends = self._probable.low, self._probable.high
        left = [max(self._subjects * end - self._done, 0) * self._each for end in ends]
        return durations(left[0], left[1])
