"""What a report consists of: sections with text, tables and figures, in no markup."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.figures.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Attributes
    ----------
    caption
        What it shows.
    header
        A text for each column.
    rows
        Texts, as many as columns; the first one names the row.
    numeric
        Columns of numbers, which are set to the right.
    folded
        Whether it is shown only on demand.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[int] = ()
    folded: bool = False


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the report.

    Attributes
    ----------
    name
        Its place in the page.
    title
        What it answers.
    lead
        The answer, in a sentence or two.
    figures, tables
        What shows it.
    notes
        What one should know of it.
    """

    name: str
    title: str
    lead: str
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()


def number(value: float | None) -> str:
    """Show a number by four digits."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.4g}"


def quantity(value: float | None, unit: str) -> str:
    """Show a number with its unit."""
    return f"{number(value)} {unit}".rstrip()


def values(mapping: Mapping[str, float]) -> str:
    """Show named numbers in one line."""
    return ", ".join(f"{name} {number(value)}" for name, value in mapping.items())


def change(value: float, reference: float) -> str:
    """Show how far a value is from a positive reference, in percent."""
    if not (math.isfinite(value) and math.isfinite(reference) and reference > 0.0):
        return "–"
    return f"{100.0 * (value / reference - 1.0):+.1f} %"
