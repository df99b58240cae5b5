"""Live progress of a run in the terminal."""

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Self

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn
from rich.table import Column
from rich.text import Text

from bo_tuner.evidence.trial_row import trial_row
from bo_tuner.evidence.words.trials import ending, outcome
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.display import Display
from bo_tuner.monitoring.now_and_then import NowAndThen
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.monitoring.trial_table import INDENT, TrialTable
from bo_tuner.optimizers.base import (
    ACQUISITION,
    DEFAULT,
    EXPANSION,
    INITIAL,
    RANDOM,
    REFINEMENT,
    REPETITION,
    SPACE_FILLING,
    START,
)
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import keeps_limits
from bo_tuner.study.study import Study
from bo_tuner.terminal import from_here, print_line
from bo_tuner.text import JOIN, counted, percent, printable, shown
from bo_tuner.trials import Evaluation, Trial, TrialState, Value

NUMBER_WIDTH = 9
"""Width of most numbers with four digits, such as -0.001234."""

BEST = "best so far"


class RunProgress(Display):
    """A line for each trial and, on a terminal, a bar with a second line for the incumbent.

    Without a terminal a line shows now and then how far the phase is.

    All of it is on standard error.
    """

    def __init__(
        self,
        console: Console,
        study: Study,
        status: RunStatus | None = None,
        going_on: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._study = study
        self._status = status
        self._going_on = going_on
        self._console = console
        self._progress = _TwoLines(console)
        self._lines = NowAndThen(clock)
        self._table = TrialTable(study, console)

    def __enter__(self) -> Self:
        """Start the live display, which is empty before the first phase."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal."""
        self._progress.stop()

    def start(self, folder: Path, backend: str, algorithm: str) -> None:
        """Show the run folder."""
        self.inform(f"run folder {from_here(folder)}")
        if warning := self._study.budget.warning:
            self.inform(warning)

    def begin(self, phase: str, total: int) -> None:
        """Start counting `total` steps of `phase`."""
        for task in self._progress.task_ids:
            self._progress.remove_task(task)
        self._task = self._progress.add_task(phase, total=total, note="")
        self._show()

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Count the recorded trials, and show their incumbent."""
        self._progress.second_line = incumbent_in_words(incumbent, self._study)
        self._show(steps=len(trials))

    def evaluation(self, evaluation: Evaluation) -> None:
        """Update the times, and show what there is to know of a run."""
        self._show()
        if (note := evaluation.outcome.notes.remark) and not evaluation.recorded:
            self.inform(f"warning: {evaluation.place}: {note}")

    def advance(self) -> None:
        """Count a step that is not a trial."""
        self._show(steps=1)

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Count a trial, and show it and the incumbent."""
        self._progress.second_line = incumbent_in_words(incumbent, self._study)
        self._show(steps=1)
        best = incumbent is not None and incumbent.trial.number == trial.number
        mark = BEST if incumbent is not None and best and incumbent.believed_feasible else ""
        for line in self._table.lines(trial, mark):
            self._console.print(line, soft_wrap=True)
        self._lines.printed()
        for warning in trial.warnings:
            self._print(f"{INDENT}warning: {warning}", INDENT)

    def advise(self, advice: StopAdvice) -> None:
        """Show the advice to stop."""
        self.inform(advice_in_words(advice, self._study))

    def pause(self, paused: bool) -> None:
        """Show the start or the end of a pause."""
        self._show()
        self.inform(f"paused; {self._going_on}" if paused else "continuing")

    def asking(self, asked: bool) -> None:
        """Leave the terminal to a question."""
        if asked:
            self._progress.stop()
        else:
            self._progress.start()

    def inform(self, text: str) -> None:
        """Show a line of information above the bar."""
        self._print(text, "  ")

    def _print(self, text: str, indent: str) -> None:
        print_line(self._console, text, indent)
        self._lines.printed()

    def _show(self, steps: int = 0) -> None:
        parts = []
        total = None
        if self._status is not None:
            now = self._status.now
            total = now.total
            if now.time_left is not None:
                parts.append(f"{duration(now.time_left)} left")
            if now.overhead is not None:
                parts.append(f"optimizer {now.overhead:.0%}")
            if now.paused:
                parts.append("PAUSED")
        note = "  ".join(parts)
        self._progress.update(self._task, total=total, advance=steps, note=note)
        if self._lines.due and not self._console.is_terminal:
            task = self._progress.tasks[-1]
            self.inform("  ".join(filter(None, [f"{task.description}: {_count(task)}", note])))


def _count(task: Task) -> str:
    """Return how many steps of a phase are done."""
    return f"{task.completed:.0f} of {task.total or 0:.0f}"


class _TwoLines(Progress):
    """A progress bar with a line of text below."""

    def __init__(self, console: Console) -> None:
        self.second_line = ""
        super().__init__(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            # Takes the rest of the line, and goes on below where that is too short.
            TextColumn(
                "{task.fields[note]}",
                markup=False,
                table_column=Column(ratio=1, overflow="fold"),
            ),
            console=console,
            expand=True,
            # Drawing takes computing time from the run.
            refresh_per_second=2,
            # A log file gets only the lines of the trials.
            disable=not console.is_terminal,
        )

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield the bar and the line."""
        yield from super().get_renderables()
        if self.second_line:
            yield Text(printable(self.second_line), overflow="fold")


def incumbent_in_words(best: Candidate | None, study: Study) -> str:
    """Describe the incumbent in a line."""
    if best is None:
        return "no complete trial yet"
    return f"best within limits: {best_within(best, study)}"


def best_within(best: Candidate | None, study: Study) -> str:
    """Describe the incumbent if it is believed within limits, and else the closest trial.

    What its own test runs showed does not change with the models of the trials to come.
    """
    if best is None:
        return "none yet"
    likely = f"{percent(best.feasibility)} likely within limits"
    if not best.believed_feasible:
        own = "kept all limits in its own test runs, " if keeps_limits(study, best.trial) else ""
        return f"none yet; closest: trial {best.trial.number}, {own}{likely}"
    metric = study.metrics[study.objective.metric]
    # The same number as in the row of the trial; models have another one, when they smooth.
    mean = best.trial.mean(metric.name)
    value = f"{best.objective if mean is None else mean:.4g} {metric.unit}".rstrip()
    return f"trial {best.trial.number}, {metric.title} {value}, {likely}"


WHY = {
    DEFAULT: "the default, to begin with",
    START: "a set to start from",
    INITIAL: "one of the initial design",
    ACQUISITION: "the largest gain is expected there",
    REFINEMENT: "close to the best, to refine it",
    RANDOM: "drawn at random",
    SPACE_FILLING: "far from all that was tried",
    EXPANSION: "to learn how far the safe sets reach",
    REPETITION: "the same again, to learn its noise",
}
"""Why a parameter set is proposed, by the origin of its trial."""


def why(origin: str) -> str:
    """Say why a parameter set is proposed; methods of others have words of their own."""
    return WHY.get(origin.partition(" (")[0], origin)


def advice_in_words(advice: StopAdvice, study: Study) -> str:
    """Describe the advice to stop in a sentence."""
    metric = study.metrics[study.objective.metric]
    unit = f" {metric.unit}" if metric.unit else ""
    return (
        f"advice: stop here; according to the models, the {advice.remaining} remaining trials are "
        f"expected to gain {advice.expected_gain:.2g}{unit} in {metric.title}, less than the "
        f"standard error of the best so far, {advice.noise:.2g}{unit}"
    )


def duration(seconds: float) -> str:
    """Format a time [s] in hours, minutes and seconds, such as 0:01:40."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _pair(title: str, value: Value) -> str:
    """Return a title with its number, in a width that aligns the numbers of all trials."""
    joined = title.replace(" ", JOIN)
    return f"{joined}{JOIN}{shown(value)}".ljust(len(joined) + 1 + NUMBER_WIDTH, JOIN)


def describe(trial: Trial, study: Study) -> str:
    """Describe a trial in a line: tuned parameters, and its values or why it has none.

    What belongs together is joined by `JOIN` instead of a space.
    """
    active = study.search_space().active(trial.parameters)
    tuned = [item for name, item in study.parameters.items() if item.is_tuned and name in active]
    where = "  ".join(_pair(item.title, active[item.name]) for item in tuned)
    if trial.state is not TrialState.COMPLETE:
        return f"{where}  {ending(trial_row(study, trial))}"
    mean, title = trial.mean(study.objective.metric), study.metrics[study.objective.metric].title
    text = f"{where}  {trial.origin if mean is None else _pair(title, mean)}"
    for objective in study.further_objectives:
        further = trial.mean(objective.metric)
        title = study.metrics[objective.metric].title
        text += "" if further is None else f"  {_pair(title, further)}"
    for worst in study.worst_case_constraints:
        value = _pair(f"worst {study.limited(worst)}", trial.worst_cases[worst.name].value)
        text += f"  {value}{JOIN}limit{JOIN}{worst.limit:g}"
    if not keeps_limits(study, trial):
        text += f"  {outcome(trial_row(study, trial))}"
    count = len(trial.evaluations)
    return f"{text}  [{counted(count, 'test run').replace(' ', JOIN)}]"
