"""What a run shows in the terminal while it goes on, and the table at its end."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

from bo_tuner.observer import RunObserver
from bo_tuner.recommendation import Candidate
from bo_tuner.study import Study
from bo_tuner.trials import Trial, TrialState
from bo_tuner.validation import Validation


class RunProgress(RunObserver):
    """Progress bar with incumbent and time left, on standard error; use it in a ``with`` block.

    Parameters
    ----------
    console
        Where to draw.
    study
        The study.
    """

    def __init__(self, console: Console, study: Study) -> None:
        self._study = study
        self._console = console
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            # Takes what the line has left, and is cut off there.
            TextColumn(
                "{task.fields[note]}",
                markup=False,
                table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
            ),
            console=console,
            expand=True,
            # A log file gets the lines of the trials instead.
            disable=not console.is_terminal,
        )

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def begin(self, phase: str, total: int) -> None:
        """Start counting `total` steps of `phase`."""
        for task in self._progress.task_ids:
            self._progress.remove_task(task)
        self._task = self._progress.add_task(phase, total=total, note="")

    def skip(self, steps: int) -> None:
        """Count steps that were done before."""
        self._progress.update(self._task, completed=steps)

    def advance(self) -> None:
        """Count one step."""
        self._progress.advance(self._task)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Count a trial, and tell of it and of the incumbent."""
        self._progress.update(self._task, advance=1, note=self._incumbent(incumbent))
        line = f"trial {trial.number:3d}  {describe(trial, self._study)}"
        self._console.print(line, soft_wrap=True)
        for warning in trial.warnings:
            self._console.print(f"           warning: {warning}", soft_wrap=True)

    def _incumbent(self, best: Candidate | None) -> str:
        if best is None:
            return "no complete trial yet"
        metric = self._study.metrics[self._study.objective.metric]
        if not best.believed_feasible:
            return f"no feasible point yet (least violating: trial {best.trial.number})"
        value = f"{best.objective:.4g} {metric.unit}".rstrip()
        return (
            f"incumbent: trial {best.trial.number}, {metric.name} {value}, "
            f"P(feasible) {best.feasibility:.2f}"
        )


def describe(trial: Trial, study: Study) -> str:
    """Tell a trial in a line: parameters, and its values or why it failed."""
    tuned = [name for name, item in study.parameters.items() if item.is_tuned]
    where = "  ".join(f"{name} {trial.parameters[name]:.4g}" for name in tuned)
    if trial.state is TrialState.FAILED:
        cut = trial.cuts[-1]
        context = ", ".join(f"{name} {value:.3f}" for name, value in cut.context.items())
        return f"{where}  FAILED: {trial.reason} (context {context}; seed {cut.seed})"
    values = trial.observations(study.objective.metric)
    text = f"{where}  {study.objective.metric} {sum(values) / len(values):.4g}"
    worst = study.worst_case_constraint
    if worst is not None and trial.worst_case is not None:
        verdict = "above" if trial.worst_case.value > worst.upper else "within"
        text += f"  worst {worst.metric} {trial.worst_case.value:.4g} ({verdict} {worst.upper:g})"
    return f"{text}  [{len(trial.cuts)} cuts]"


def comparison(study: Study, default: Validation, tuned: Validation) -> Table:
    """Table of the default against the tuned parametrization on the same fresh draws."""
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
        table.add_row(name, item.unit, *[f"{v.parameters[name]:.4g}" for v in both])
    table.add_section()
    metric = study.metrics[study.objective.metric]
    table.add_row(
        f"mean {metric.name}",
        metric.unit,
        *[f"{v.objective:.4g} ± {v.deviation / v.draws**0.5:.2g}" for v in both],
    )
    for index, constraint in enumerate(study.constraints.values()):
        unit = study.metrics[constraint.metric].unit
        checks = [v.constraints[index] for v in both]
        table.add_row(
            f"largest {constraint.metric}", unit, *[f"{check.worst:.4g}" for check in checks]
        )
        table.add_row(
            f"  draws above {constraint.upper:g}", "", *[str(check.violations) for check in checks]
        )
    table.add_row("failed cuts", "", *[str(v.failures) for v in both])
    table.add_section()
    table.add_row("feasible", "", *["yes" if v.feasible else "NO" for v in both])
    return table
