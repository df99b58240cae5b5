"""Text from outside, such as names in a study and messages of nodes, made fit to be shown."""

import math
import textwrap
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

JOIN = "\xa0"
"""In place of a space, between what stays on one line, such as a name and its number."""
MOST_SAID = 500
"""Characters that are kept of a reason, or of a value, that a node gives."""


def printable(text: str) -> str:
    r"""Escape what would steer a terminal, or reorder its line or that of a page, as Python does.

    Line breaks stay, and so do the spaces of any width; all other control and format characters
    (escape sequences, changes of the direction of writing) are shown like ``\x1b``.
    """
    if text.isprintable():
        return text
    return "".join(
        c
        if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs"
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def one_line(text: str) -> str:
    """Make text fit for a single line of a terminal."""
    return printable(" ".join(text.split()))


def wrapped(text: str, width: int, indent: str = "") -> str:
    """Break a line between words, never in one; all lines but the first begin with `indent`."""
    return textwrap.fill(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def brief(text: str) -> str:
    """Make what a node says, however long, fit for a line of a terminal or a table."""
    return one_line(text[:MOST_SAID])


def csv_cell(value: object) -> object:
    """Keep a spreadsheet from reading text as a formula, by an apostrophe ahead of it.

    A number stays as it is, also if it is given as text; a truth value is ``true`` or ``false``,
    and of NaN, which stands for no number, the cell is empty.
    The danger is described at https://owasp.org/www-community/attacks/CSV_Injection.
    """
    if isinstance(value, bool):
        return shown(value)
    if isinstance(value, float) and math.isnan(value):
        return ""
    if not isinstance(value, str) or not value.startswith(("=", "+", "-", "@", "\t", "\r", "\n")):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def shown(value: bool | int | float | str) -> str:
    """Format a value: an integer in full, any other number with four digits, a dash for NaN.

    A truth value is ``true`` or ``false``.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isnan(value):
        return "–"
    return f"{value + 0.0:.4g}" if isinstance(value, float) else str(value)  # no "-0"


def shown_beside(value: float, limit: float) -> str:
    """Format a number with so many digits, at least four, that its side of a limit is seen.

    A dash stands for NaN.
    """
    if math.isnan(value):
        return "–"
    for digits in range(4, 17):
        text = f"{value + 0.0:.{digits}g}"
        if (float(text) > limit, float(text) < limit) == (value > limit, value < limit):
            return text
    return repr(value)


def values(mapping: Mapping[str, bool | int | float | str]) -> str:
    """Format named values, such as a context, in one line."""
    return ", ".join(f"{name} {shown(value)}" for name, value in mapping.items())


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets; the name alone if it has no unit."""
    return f"{name} [{unit}]" if unit else name


def percent(probability: float) -> str:
    """Format a probability in percent, not nearer to 0 or 1 than one in a thousand."""
    if math.isnan(probability):
        return "–"
    if 0.0 < probability < 0.001:
        return "less than 0.1 %"
    if 0.999 < probability < 1.0:
        return "more than 99.9 %"
    return f"{100.0 * probability:.3g} %"


def capitalized(text: str) -> str:
    """Return text with a capital letter at its beginning, all others as they are."""
    return text[:1].upper() + text[1:]


def uncapitalized(text: str) -> str:
    """Return text with a small letter at its beginning, all others as they are."""
    return text[:1].lower() + text[1:]


def counted(number: int, noun: str) -> str:
    """Return a number with what it counts: ``1 trial``, ``2 trials``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(names: Sequence[str]) -> str:
    """Return names in a list such as ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def ranges(numbers: Iterable[int]) -> str:
    """Return numbers in ascending order, neighbours joined: ``3, 5–8``."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}–{run[-1]}" if run[1:] else f"{run[0]}" for run in runs)


def rounded_time(seconds: float) -> str:
    """Return a time in the unit that suits it, rounded."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"


def duration(seconds: float) -> str:
    """Return a time in words."""
    return f"about {rounded_time(seconds)}"


def durations(low: float, high: float) -> str:
    """Return a range of times in words."""
    ends = duration(low), duration(high)
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {rounded_time(high)}"
