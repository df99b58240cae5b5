"""Live progress of a certificate in the terminal."""

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bo_tuner.evidence.certificate.certification import DRAWS
from bo_tuner.monitoring.now_and_then import NowAndThen
from bo_tuner.terminal import INDENT, print_line
from bo_tuner.tuning.observer import RunObserver


class CertificateProgress(RunObserver):
    """A bar for one phase after the other; without a terminal a line for each, and now and then.

    Use it in a ``with`` block.

    Parameters
    ----------
    console
        Where to draw.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines = NowAndThen()
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> Self:
        """Start the live display, which is empty before the first phase."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal."""
        self._progress.stop()

    def begin(self, phase: str, total: int) -> None:
        """Start counting `total` steps of `phase`, at most."""
        for task in self._progress.task_ids:
            self._progress.remove_task(task)
        self._progress.add_task(phase, total=total)
        if self._progress.disable:
            most = f"at most {total}" if phase == DRAWS else f"up to about {total} evaluations"
            self._print(f"{phase}: {most}")

    def advance(self) -> None:
        """Count a step."""
        for task in self._progress.tasks:
            self._progress.advance(task.id)
            if self._progress.disable and self._lines.due:
                self._print(f"{task.description}: {task.completed:.0f} of {task.total or 0:.0f}")

    def _print(self, text: str) -> None:
        print_line(self._console, text, INDENT)
        self._lines.printed()
