"""The content of a report without markup: chapters of sections with text, tables and figures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.evidence.words.next_steps import Step
from bo_tuner.figures.figure import Figure
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.text import shown
from bo_tuner.trials import Value


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Attributes
    ----------
    caption
        Caption, in plain text.
    header
        Heading of each column.
    rows
        Texts, one for each column; the first is the heading of the row.
    numeric
        Indices of the columns to align right.
    folded
        Whether the table is collapsed at first.
    sortable
        Whether the reader can sort and filter the rows.
    marked
        Indices of rows that stand out.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[int] = ()
    folded: bool = False
    sortable: bool = False
    marked: Sequence[int] = ()


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A parameter set that the reader may choose, folded at first.

    Attributes
    ----------
    trial
        Number of its trial.
    title
        What it is, in a line.
    values
        Its parameters beside those of the result.
    steps
        Commands that put it to use.
    figure
        Its response; None if there are no signals.
    """

    trial: int
    title: str
    values: Table
    steps: Sequence[Step]
    figure: Figure | None


@dataclass(frozen=True)
class Slider:
    """The values of a parameter, from its lower to its upper bound.

    Attributes
    ----------
    name, title
        Its name, and what screens call it, with its unit.
    values, words
        The values (n,), and the same in words.
    place
        Which of them is that of the answer.
    """

    name: str
    title: str
    values: Sequence[float]
    words: Sequence[str]
    place: int


@dataclass(frozen=True)
class Forecast:
    """What is predicted of a parameter set.

    Attributes
    ----------
    cells
        A prediction with its band for each row of `WhatIf.rows`, in words.
    remark
        Why it must not be relied on; empty if it may.
    """

    cells: Sequence[str]
    remark: str


@dataclass(frozen=True)
class WhatIf:
    """Sliders, and what is predicted along them.

    Attributes
    ----------
    sliders
        One for each tuned number.
    rows
        What is predicted, and its limit in words, which is empty without one.
    along
        For each slider the forecasts (n,) at its values, the others being those of the answer.
    command
        Runs such a set once, with the values of the sliders behind it; empty where none can.
    """

    sliders: Sequence[Slider]
    rows: Sequence[tuple[str, str]]
    along: Sequence[Sequence[Forecast]]
    command: str = ""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the report.

    Attributes
    ----------
    name
        Its identifier in the page and its entry in the navigation.
    title
        Heading; empty for the only section of a chapter.
    lead
        The message, in a sentence or two.
    figures, tables
        Its figures and tables, in order.
    notes
        Remarks at the end.
    choices
        Parameter sets to choose from.
    what_if
        Sliders over the predictions; None without any.
    """

    name: str
    title: str
    lead: str
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    choices: Sequence[Choice] = ()
    what_if: WhatIf | None = None


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """Sections that answer one question of a reader.

    Attributes
    ----------
    name
        Its identifier in the page and its entry in the navigation.
    title
        Heading.
    sections
        At least one.
    closed
        Whether it is collapsed at first.
    """

    name: str
    title: str
    sections: Sequence[Section]
    closed: bool = False


def number(value: Value | None) -> str:
    """Format a value as `shown` does; a dash for None, too."""
    return "–" if value is None else shown(value)


def quantity(value: float | None, unit: str) -> str:
    """Format a number with its unit."""
    return f"{number(value)} {unit}".rstrip()


def change(value: float, reference: float) -> str:
    """Format the change of a value relative to a positive reference, in percent."""
    if not (math.isfinite(value) and math.isfinite(reference) and reference > 0.0):
        return "–"
    return f"{100.0 * (value / reference - 1.0):+.1f} %"


def method_in_words(name: str) -> str:
    """Return what a reader knows a method by: its name, of the default one what it is for."""
    return "robust (default)" if name == DEFAULT_METHOD else name


def numbered(name: str, place: int) -> str:
    """Return a figure's name for each of several alike: the first has no number."""
    return name if place == 0 else f"{name}-{place + 1}"
