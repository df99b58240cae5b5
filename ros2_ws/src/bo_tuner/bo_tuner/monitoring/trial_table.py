"""The table of a run's trials in the terminal: a header, then a line for each as it ends.

A value beyond its limit has the sign `OVER`, one that is too close to it `MARGIN`, and a colour.
Values whose columns do not fit follow below the line: those of the parameters first.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import nan

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import held_against, outcome_on_screen, uncertain, violated
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.study import Study
from bo_tuner.text import JOIN, printable, shown, shown_beside, wrapped
from bo_tuner.trials import Trial, TrialState

INDENT = " " * 6
"""Of the lines that continue that of a trial."""
OVER, MARGIN, KEPT = "!", "~", " "
STYLES = {OVER: "red", MARGIN: "yellow", KEPT: "green"}
NUMBER_WIDTH = 9
"""Width of most numbers with four digits, such as -0.001234."""
LONGEST_NAME = 11
"""Width up to which a name in the header is not broken."""
REPEATED = 25
"""Trials after which the header is shown again."""
LEAST_OUTCOME = 14
"""Room for ``over the limit``."""


@dataclass(frozen=True)
class _Column:
    name: str
    header: Sequence[str]
    width: int


class TrialTable:
    """Makes the lines of trials."""

    def __init__(self, study: Study, console: Console) -> None:
        self._study = study
        self._console = console
        self._shown = 0
        tuned = [item for item in study.parameters.values() if item.is_tuned]
        self._tuned = tuned
        self._parameters = [_column(item.title, item.unit, "", _width(item)) for item in tuned]
        self._values = [_column("trial", "", "", 0)]
        for objective in study.objectives:
            metric = study.metrics[objective.metric]
            self._values.append(_column(metric.title, metric.unit, "", NUMBER_WIDTH))
        for constraint in study.constraints.values():
            worst = "worst " if constraint.rule.in_every_context else ""
            title = study.titled(constraint, f"{worst}{study.limited(constraint)}")
            limit = f"{'≤' if constraint.sign > 0.0 else '≥'} {constraint.limit:g}"
            unit = study.metrics[constraint.metric].unit
            # With the sign.
            self._values.append(_column(title, unit, limit, NUMBER_WIDTH, trailing=1))

    def lines(self, trial: Trial, mark: str) -> Iterator[Text]:
        """Yield the lines of a trial, the header ahead of them where it is due."""
        room = self._console.width if self._console.is_terminal else None
        beside = room is None or _total(self._columns(beside=True)) + LEAST_OUTCOME <= room
        columns = self._columns(beside=beside)
        shown_apart = self._parameters if not beside else []
        if room is not None and _total(columns) > room:
            columns, shown_apart = columns[:1], self._columns(beside=True)[1:]
        if self._shown % REPEATED == 0:
            yield from _header(columns)
        self._shown += 1
        cells = self._cells(trial)
        line = Text(" ").join(_aligned(cells[id(column)], column) for column in columns)
        left = None if room is None else room - line.cell_len - 2
        outcome, style = self._outcome(trial, None if left is None or mark else left)
        said, rest = "; ".join(filter(None, (mark, outcome))), []
        if left is not None and cell_len(said) > left:
            rest, said = [said], ""
        if said:
            line = Text.assemble(line, "  ", (said, style))
        line.rstrip()
        yield line
        if trial.state is not TrialState.COMPLETE:
            rest.append(ending_in_words(trial))
        if shown_apart:
            named = (f"{column.name} {cells[id(column)]}".strip() for column in shown_apart)
            rest.append("  ".join(pair.replace(" ", JOIN) for pair in named))
        for text in rest:
            text = printable(INDENT + text)
            text = text if room is None else wrapped(text, room, INDENT)
            yield Text(text.replace(JOIN, " "))

    def _columns(self, *, beside: bool) -> list[_Column]:
        first, *others = self._values
        return [first, *(self._parameters if beside else ()), *others]

    def _cells(self, trial: Trial) -> dict[int, Text]:
        """Return the cells by the identity of their columns; two may have the same name."""
        study, complete = self._study, trial.state is TrialState.COMPLETE
        cells = [Text(str(trial.number))]
        parameters = study.on_screen(trial.parameters)
        cells += [Text(printable(shown(parameters[item.name]))) for item in self._tuned]
        for objective in study.objectives:
            mean = trial.mean(objective.metric) if complete else None
            cells.append(Text(shown(nan if mean is None else mean)))
        over, close = (violated(study, trial), uncertain(study, trial)) if complete else ((), ())
        for name, constraint in study.constraints.items():
            sign = OVER if name in over else MARGIN if name in close else KEPT
            cells.append(_against(constraint, trial, sign) if complete else Text(f"–{KEPT}"))
        columns = map(id, self._columns(beside=True))
        return dict(zip(columns, cells, strict=True))

    def _outcome(self, trial: Trial, left: int | None) -> tuple[str, str]:
        """Return the outcome in words that fit into the room that is left, and their style."""
        over, close = violated(self._study, trial), uncertain(self._study, trial)
        if trial.state is not TrialState.COMPLETE or not (over or close):
            return "", STYLES[KEPT]
        words = outcome_on_screen(self._study, trial)
        if left is not None and cell_len(words) > left:
            # The values stand in the table.
            words = words.partition(" (")[0]
        return words, STYLES[OVER if over else MARGIN]


def ending_in_words(trial: Trial) -> str:
    """Return how a trial ended that is not complete, with what it takes to repeat that."""
    evaluation = trial.evaluations[-1]
    context = ", ".join(
        f"{name} {value:.3f}" if isinstance(value, float) else f"{name} {shown(value)}"
        for name, value in evaluation.context.items()
    )
    conditions = f"context {context or 'none'}; seed {evaluation.seed}"
    how = "" if trial.state is TrialState.CUT_SHORT else f"{trial.ending.upper()}: "
    return f"{how}{trial.reason} ({conditions})"


def _column(title: str, unit: str, limit: str, least: int, trailing: int = 0) -> _Column:
    """Return a column whose header is broken where a name has a space or an underscore."""
    room = max(least, len(unit), LONGEST_NAME)
    header = [*_broken(printable(title), room), printable(unit), limit]
    width = max(least, *map(cell_len, header)) + trailing
    header = [f"{text}{' ' * trailing}" if text else "" for text in header]
    return _Column(printable(title), header, width)


def _broken(title: str, width: int) -> list[str]:
    lines = [""]
    for part in title.replace("_", "_ ").split():
        joint = "" if lines[-1].endswith("_") or not lines[-1] else " "
        if lines[-1] and cell_len(f"{lines[-1]}{joint}{part}") > width:
            lines.append(part)
        else:
            lines[-1] += f"{joint}{part}"
    return lines


def _width(item: Parameter) -> int:
    """Return the width of the values of a tuned parameter."""
    if item.is_number and not item.is_integer:
        return NUMBER_WIDTH
    values = item.bounds if item.is_integer and item.bounds else item.levels
    return max(cell_len(shown(value)) for value in values)


def _total(columns: Sequence[_Column]) -> int:
    return sum(column.width for column in columns) + len(columns) - 1 + 2


def _header(columns: Sequence[_Column]) -> Iterator[Text]:
    """Yield the header: names, the last line of each above its unit, then units, then limits."""
    most = max(len(column.header) for column in columns)
    rows = [("",) * (most - len(column.header)) + (*column.header,) for column in columns]
    for texts in zip(*rows, strict=True):
        if any(texts):
            pairs = zip(texts, columns, strict=True)
            cells = (_aligned(Text(text), column) for text, column in pairs)
            yield Text(Text(" ").join(cells).plain.rstrip())


def _against(constraint: Constraint, trial: Trial, sign: str) -> Text:
    value = held_against(constraint, trial)
    return Text(f"{shown_beside(value, constraint.limit)}{sign}", STYLES[sign])


def _aligned(cell: Text, column: _Column) -> Text:
    return Text(" " * max(column.width - cell.cell_len, 0)) + cell
