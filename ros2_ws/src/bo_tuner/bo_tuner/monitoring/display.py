"""Output of a run: the base class of the displays, and the consoles."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from rich.console import Console
from rich.text import Text

from bo_tuner.evidence.verdict import Verdict
from bo_tuner.evidence.words.terminal import print_next_steps, print_verdict
from bo_tuner.evidence.words.verdict import headline, sentences
from bo_tuner.monitoring.front import print_front
from bo_tuner.plans import ON_REQUEST, Event, EventKind, Phase
from bo_tuner.study.study import Study
from bo_tuner.terminal import INDENT, from_here, print_line
from bo_tuner.text import counted, printable
from bo_tuner.trials import Value
from bo_tuner.tuning.observer import RunObserver


class Output(StrEnum):
    """Kind of output of a run."""

    PROGRESS = "progress"
    QUIET = "quiet"
    JSON_LINES = "json-lines"


@dataclass(frozen=True)
class Result:
    """Result of a run.

    Attributes
    ----------
    study
        The study.
    verdict
        The verdict on it.
    tuned
        The tuned parameter set.
    parameters_file
        File with the tuned parameter set, in the run folder.
    summary
        Content of ``summary.json``.
    """

    study: Study
    verdict: Verdict
    tuned: Mapping[str, Value]
    parameters_file: Path
    summary: Mapping[str, object]


class Display(RunObserver):
    """Shows only the result and warnings; use it in a ``with`` block."""

    def __init__(self) -> None:
        self._console = plain_console(stderr=True)

    def __enter__(self) -> Self:
        """Start the display."""
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal."""

    def start(self, folder: Path, backend: str, algorithm: str) -> None:
        """Show the run folder, the backend and the algorithm."""

    def inform(self, text: str) -> None:
        """Show a line of information, which ``--quiet`` omits."""

    def warn(self, text: str) -> None:
        """Show a warning on standard error."""
        print_line(self._console, text, INDENT)

    def event(self, event: Event) -> None:
        """Show that the run is to finish, whoever has asked, or cannot go on."""
        if event.kind is EventKind.STANDSTILL:
            self.warn(f"the search ends after {counted(event.tasks, 'trial')}: {event.detail}")
        if event.kind is not EventKind.FINISH:
            return
        if event.phase == Phase.TUNING:
            after, then = counted(event.tasks, "trial"), "settled and validated"
        else:
            what = "run that settles" if event.tasks == 1 else "runs that settle"
            after, then = f"{event.tasks} {what} the answer", "validated"
        why = "asked to finish" if event.detail == ON_REQUEST else event.detail
        self.inform(f"{why} after {after}; the best so far is then {then}")

    def result(self, result: Result) -> None:
        """Show the result on standard output."""
        out = plain_console()
        print_verdict(out, result.study, result.verdict, result.tuned)
        front = result.summary.get("front")
        if isinstance(front, list):
            print_front(
                out, result.study, front, result.verdict.trial, result.parameters_file.parent
            )
        out.print(f"parameters: {from_here(result.parameters_file)}", soft_wrap=True)
        print_next_steps(out, result.verdict, result.parameters_file.parent)

    def no_result(self, verdict: Verdict, folder: Path) -> None:
        """Warn that the run in a folder has no result, with why and what to do next."""
        self.warn(headline(verdict))
        for sentence in sentences(verdict):
            self.warn(f"  {sentence}")
        print_next_steps(self._console, verdict, folder)

    def finish(self, code: int) -> None:
        """Show that the run has ended with an exit code."""


class PlainConsole(Console):
    """A console that shows texts as they are, but for what would steer the terminal."""

    def __init__(self, stderr: bool = False) -> None:
        # What stands in brackets is no markup.
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Make a renderable of a text, through which all texts and cells of tables pass."""
        return super().render_str(printable(text), **options)

    def on_broken_pipe(self) -> None:
        """Raise the error again, where rich would end the process."""
        raise


def plain_console(stderr: bool = False) -> Console:
    """Make a console for texts of others."""
    return PlainConsole(stderr)


def say(text: str) -> None:
    """Print a line on standard output, without markup; on a terminal it is broken between words."""
    print_line(plain_console(), text, INDENT)
