"""Makes the certificate of one parameter set of a run, and shows how far it is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.cli.common import opened
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.certification import (
    DRAWS,
    Certification,
    Subject,
    most_evaluations,
)
from bo_tuner.evidence.certificate.making import make_certificate, write_certificate
from bo_tuner.evidence.certificate.outlook import outlook
from bo_tuner.evidence.certificate.subjects import subjects_of
from bo_tuner.evidence.certificate.unfinished import Unfinished
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.now_and_then import NowAndThen
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.terminal import print_line
from bo_tuner.text import counted
from bo_tuner.trials import Trial
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.observer import Observers, RunObserver


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

    def certify(
        self, trial: Trial, draws: int, attempt: int, best_sha256: str | None
    ) -> tuple[Certificate, Path, list[str]]:
        """Run all evaluations of a trial's parameter set, and write its certificate.

        Parameters
        ----------
        trial
            Of the run.
        draws
            Largest number of draws.
        attempt
            Number of the certificate in the run, from 1.
        best_sha256
            Digest of the parameter file, of the run's result only.

        Returns
        -------
        Certificate, Path, list of str
            Where it is, and what the nodes could not be left with.

        Raises
        ------
        Interrupted
            If the evaluations are; the next call goes on after them.
        RunError, OutputError
            If the nodes are lost or disturbed too often, or a file cannot be written.
        """
        study, folder = self.record.study, self.folder
        nodes = self.make_nodes()
        subjects = subjects_of(self.record, trial, nodes.name, with_default=self.with_default)
        self._show_earlier(subjects)
        confidence = spent(self.confidence, attempt, len(subjects))
        self._show_most(subjects, draws, trial, confidence)
        unfinished = Unfinished(folder.path, study, trial.parameters, nodes.name, attempt)
        if unfinished.evaluations:
            done = counted(len(unfinished.evaluations), "evaluation")
            self.console.print(
                f"continuing the interrupted certificate of trial {trial.number} after {done}"
            )
        backend = RecordedEvaluations(nodes, study, unfinished.evaluations)
        try:
            bar, observers = Bar(self.console), Observers()
            observers.add(unfinished)
            observers.add(bar)
            certification = Certification(
                study,
                Driver(
                    backend,
                    observers,
                    window=self.window,
                    gate=Gate(self.interruption.check, observers),
                ),
                confidence=confidence,
                attempt=attempt,
            )
            with opened(backend, self.interruption, again=self.more) as left, bar.progress:
                collected = certification.collect(subjects, draws)
        finally:
            unfinished.close()
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
        path = write_certificate(folder.path, certificate, evidence)
        unfinished.remove()
        return certificate, path, left

    def _show_earlier(self, subjects: Sequence[Subject]) -> None:
        """Say what failed before, and where it is evaluated again."""
        for subject in subjects:
            for refutation in subject.earlier.refutations:
                count = len(refutation.contexts)
                failed = f"{counted(count, 'context')} that failed {'are' if count > 1 else 'is'}"
                again = f"its {failed} evaluated again, and " if count else ""
                line = f"{subject.name}: {refutation.told}; {again}its runs count against a PASS"
                print_line(self.console, line, "  ")

    def _show_most(
        self, subjects: Sequence[Subject], draws: int, trial: Trial, confidence: float
    ) -> None:
        """Say how many evaluations it takes at most, and probably if it passes."""
        most = most_evaluations(self.record.study, subjects, draws)
        parts = [f"{most.drawn} draws"]
        if most.searched:
            parts.append(f"{most.searched} to search for the worst contexts")
        if most.repeated:
            parts.append(f"{most.repeated} in the worst contexts found")
        print_line(
            self.console,
            f"at most {most.total} evaluations ({', '.join(parts)}), fewer once the verdict is "
            "clear",
            "  ",
        )
        drawn = subjects[-1].earlier.drawn
        probable = outlook(self.record.study, trial, drawn, draws, confidence)
        if probable is not None:
            each = " each" if len(subjects) > 1 else ""
            self.console.print(
                f"probably {probable} evaluations{each}, by the margins of the run, if it passes",
                soft_wrap=True,
            )


class Bar(RunObserver):
    """A bar for one phase after the other; without a terminal a line for each, and now and then.

    Parameters
    ----------
    console
        Shows it.

    Attributes
    ----------
    progress
        The bar, to be used in a ``with`` block.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines = NowAndThen()
        self.progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )

    def begin(self, phase: str, total: int) -> None:
        """Show a bar for a phase in place of that of the one before."""
        for task in self.progress.task_ids:
            self.progress.remove_task(task)
        self.progress.add_task(phase, total=total)
        if self.progress.disable:
            most = f"at most {total}" if phase == DRAWS else f"up to about {total} evaluations"
            self._print(f"{phase}: {most}")

    def advance(self) -> None:
        """Show a step."""
        for task in self.progress.tasks:
            self.progress.advance(task.id)
            if self.progress.disable and self._lines.due:
                self._print(f"{task.description}: {task.completed:.0f} of {task.total or 0:.0f}")

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)
        self._lines.printed()
