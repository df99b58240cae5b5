"""Output of a run: the base class of the displays, and the table of the result."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bo_tuner.study.study import Study
from bo_tuner.text import printable, shown
from bo_tuner.tuning.observer import RunObserver
from bo_tuner.tuning.validation import Validation


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
    default, tuned
        Validations of the two parameter sets.
    parameters_file
        File with the tuned parameter set.
    problem
        Why the tuned parameter set is not feasible, in a sentence; empty if it is.
    summary
        Content of ``summary.json``.
    """

    study: Study
    default: Validation
    tuned: Validation
    parameters_file: Path
    problem: str
    summary: Mapping[str, object]


class Display(RunObserver):
    """Shows only the result and warnings; use it in a ``with`` block."""

    def __init__(self) -> None:
        self._console = plain_console(stderr=True)

    def __enter__(self) -> Self:
        """Start the display."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Restore the terminal."""

    def start(self, folder: Path, backend: str, algorithm: str) -> None:
        """Show the run folder, the backend and the algorithm."""

    def tell(self, text: str) -> None:
        """Show a line of information, which ``--quiet`` omits."""

    def warn(self, text: str) -> None:
        """Show a warning on standard error."""
        self._console.print(text, soft_wrap=True)

    def result(self, result: Result) -> None:
        """Show the result on standard output."""
        out = plain_console()
        out.print(comparison(result.study, result.default, result.tuned))
        out.print(f"parameters: {result.parameters_file}", soft_wrap=True)
        if result.problem:
            out.print(result.problem, soft_wrap=True)

    def finish(self, code: int) -> None:
        """Show that the run has ended with an exit code."""


class PlainConsole(Console):
    """A console that shows texts as they are, but for what would steer the terminal.

    Parameters
    ----------
    stderr
        Whether to write to standard error.
    """

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
    """Print a line on standard output, without markup or wrapping."""
    plain_console().print(text, soft_wrap=True)


def comparison(study: Study, default: Validation, tuned: Validation) -> Table:
    """Make a table that compares the default with the tuned parameter set on the same draws."""
    table = Table(
        title=f"{study.name}: default against tuned, the same {tuned.draws} fresh draws",
        title_justify="left",
    )
    table.add_column("")
    table.add_column("unit")
    table.add_column("default", justify="right")
    table.add_column("tuned", justify="right")
    both = (default, tuned)
    for name, item in study.parameters.items():
        table.add_row(name, item.unit, *[shown(v.parameters[name]) for v in both])
    table.add_section()
    metric = study.metrics[study.objective.metric]
    table.add_row(
        f"mean {metric.name}",
        metric.unit,
        *[f"{v.objective:.4g} ± {v.deviation / v.draws**0.5:.2g}" for v in both],
    )
    for name, constraint in study.constraints.items():
        unit = study.metrics[constraint.metric].unit
        samples = [v.constraints[name] for v in both]
        table.add_row(
            f"largest {constraint.metric}", unit, *[f"{sample.worst:.4g}" for sample in samples]
        )
        table.add_row(
            f"  draws above {constraint.upper:g}",
            "",
            *[str(sample.violations) for sample in samples],
        )
    table.add_row("failed evaluations", "", *[str(v.failures) for v in both])
    table.add_section()
    table.add_row("feasible", "", *["yes" if v.feasible else "NO" for v in both])
    return table
