"""Text of others, on a terminal and in a table."""

import io
import math

import pytest

from bo_tuner.monitoring.display import PlainConsole
from bo_tuner.text import csv_cell, one_line, printable, shown, shown_beside

HOSTILE = "\x1b[2Jx\x07\x9b1m\u202etxt\u2066\u200f\r"


def test_nothing_steers_the_terminal():
    assert printable(f"{HOSTILE}\nü [b]") == (
        r"\x1b[2Jx\x07\x9b1m\u202etxt\u2066\u200f\r" "\nü [b]"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-0.0, "0"),
        (0.0, "0"),
        (-0.5, "-0.5"),
        (12345.6, "1.235e+04"),
        (7, "7"),
        (12345, "12345"),
        (-10001, "-10001"),
        (True, "true"),
    ],
)
def test_a_value(value, text):
    assert shown(value) == text


@pytest.mark.parametrize(
    ("value", "limit", "text"),
    [
        (1.00002, 1.0, "1.00002"),
        (0.99999, 1.0, "0.99999"),
        (1.0, 1.0, "1"),
        (-0.20001, -0.2, "-0.20001"),
        (0.5678912, 1.0, "0.5679"),
        (math.inf, 1.0, "inf"),
        (math.nan, 1.0, "–"),
        (math.nextafter(1.0, 2.0), 1.0, "1.0000000000000002"),
    ],
)
def test_a_number_is_on_its_side_of_a_limit(value, limit, text):
    assert shown_beside(value, limit) == text


def test_a_line_stays_a_line():
    assert one_line("a\n\x1b[0m  b\x85c") == r"a \x1b[0m b c"


def test_the_console_of_all_commands_shows_no_escape_sequence():
    from rich.table import Table

    out = io.StringIO()
    console = PlainConsole()
    console.file = out
    table = Table(title=HOSTILE)
    table.add_column(HOSTILE)
    table.add_row(HOSTILE)
    console.print(HOSTILE, soft_wrap=True)
    console.print(table)
    said = out.getvalue()
    assert said.count("[2Jx") == 4
    assert not set(said) & set("\x1b\x07\x9b\u202e\u2066\u200f\r")


@pytest.mark.parametrize("text", ["=1+1", "+SUM(A1)", "-2+3|cmd", "@x", "\t=1", "\r=1", "\n=1"])
def test_a_formula_is_text(text):
    assert csv_cell(text) == f"'{text}"


@pytest.mark.parametrize("value", ["-0.5", "+1", "-inf", "text", "a=1", "", -1, None, 0.5])
def test_all_else_stays(value):
    assert csv_cell(value) == value


def test_a_truth_value_in_a_table_is_as_in_a_study():
    assert [csv_cell(value) for value in (True, False, 1, "True")] == ["true", "false", 1, "True"]
