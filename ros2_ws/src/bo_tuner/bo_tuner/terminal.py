"""Lines and tables in a terminal of any width: nothing is cut off."""

from pathlib import Path

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from bo_tuner.text import JOIN, printable, wrapped

UNLIMITED = 10_000
"""Width at which a table shows how wide it would be."""
LEAST_REMARK = 20
"""Least width of a column whose texts are broken between words."""
INDENT = "  "


def print_line(console: Console, text: str, indent: str) -> None:
    """Print a sentence, on a terminal broken between words that no `JOIN` joins."""
    if console.is_terminal:
        text = wrapped(text, console.width, indent)
    console.print(text.replace(JOIN, " "), soft_wrap=True)


def from_here(path: Path) -> Path:
    """Return a path relative to where one is, if it is below; else as it is."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def print_table(console: Console, table: Table, *, heading: int = 1, remarks: bool = False) -> None:
    """Print a table of texts, or its rows one below the other if it is too wide for the console.

    Parameters
    ----------
    console
        Where to print.
    table
        The table.
    heading
        Number of columns, from the left, that say what a row is.
    remarks
        Whether the texts of the last column may be broken between words.
    """
    excess = _width(console, table) - console.width
    if excess > 0 and remarks:
        last = table.columns[-1]
        room = max(cell_len(str(cell)) for cell in last.cells) - excess
        longest_word = max(cell_len(word) for cell in last.cells for word in str(cell).split())
        if room >= max(LEAST_REMARK, longest_word):
            last.width = room
            excess = 0
    if excess <= 0:
        console.print(table)
        return
    if table.title:
        console.print(table.title, soft_wrap=True)
    headers = [str(column.header) for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        cells = [printable(str(cell)) for cell in row]
        console.print(" ".join(filter(None, cells[:heading])).strip(), soft_wrap=True)
        pairs = zip(headers[heading:], cells[heading:], strict=True)
        named = [f"{header} {cell}".strip() for header, cell in pairs if cell]
        if named:
            text = INDENT + "  ".join(_joined(pair, console.width) for pair in named)
            console.print(wrapped(text, console.width, INDENT).replace(JOIN, " "), soft_wrap=True)


def _width(console: Console, table: Table) -> int:
    """Return the width of a table without a line that is broken."""
    return console.measure(table, options=console.options.update(width=UNLIMITED)).maximum


def _joined(pair: str, width: int) -> str:
    """Keep a name and its value on one line, if they fit into one."""
    return pair.replace(" ", JOIN) if cell_len(pair) <= width - len(INDENT) else pair
