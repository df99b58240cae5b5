"""Live progress of a certificate in the terminal."""

from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from bo_tuner.monitoring.now_and_then import NowAndThen
from bo_tuner.terminal import INDENT, print_line
from bo_tuner.tuning.observer import RunObserver


class CertificateProgress(RunObserver):
    """A bar for one phase after the other; without a terminal a line for each, and now and then.

    Use it in a ``with`` block.
    """

    def __init__(self, console: Console, time_left: Callable[[], str] = str) -> None:
        self._console = console
        self._time_left = time_left
        self._lines = NowAndThen()
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
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
        self._progress.add_task(phase, total=total, left=self._time_left())
        if self._progress.disable:
            self._print(f"{phase}: at most {total}")

    def advance(self) -> None:
        """Count a step."""
        for task in self._progress.tasks:
            left = self._time_left()
            self._progress.update(task.id, advance=1, left=left)
            if self._progress.disable and self._lines.due:
                done = f"{task.description}: {task.completed:.0f} of {task.total or 0:.0f}"
                self._print(f"{done}, {left}" if left else done)

    def _print(self, text: str) -> None:
        print_line(self._console, text, INDENT)
        self._lines.printed()
