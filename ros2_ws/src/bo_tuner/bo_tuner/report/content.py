"""The content of a report without markup: chapters of sections with text, tables and figures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.figures.figure import Figure
from bo_tuner.methods.registry import DEFAULT_METHOD
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
    """

    name: str
    title: str
    lead: str
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()


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
