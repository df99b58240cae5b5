"""Tables in a terminal of any width: what stands in their cells is read whole."""

from rich.table import Table
from terminals import console

from bo_tuner.terminal import print_table

NAME = "a_parameter_with_quite_a_long_name"


def table(*rows, title="rows"):
    made = Table(title=title, title_justify="left")
    for name in ("name", "now", "new", "remark"):
        made.add_column(name)
    for row in rows:
        made.add_row(*row)
    return made


def printed(width, made, **options):
    out = console(width)
    print_table(out, made, **options)
    return out.file.getvalue()


def test_what_fits_is_a_table():
    text = printed(80, table((NAME, "1.5", "-0.25 ± 0.1", "changes")))
    (row,) = [line for line in text.splitlines() if NAME in line]
    assert row.split("│")[1:-1] == [f" {NAME} ", " 1.5 ", " -0.25 ± 0.1 ", " changes "]


def test_what_does_not_is_stacked():
    assert printed(50, table((NAME, "1.5", "-0.25 ± 0.1", ""), ("short", "2", "", "changes"))) == (
        f"rows\n{NAME}\n  now 1.5  new -0.25 ± 0.1\nshort\n  now 2  remark changes\n"
    )


def test_a_number_stays_with_its_name_and_its_spread():
    text = printed(24, table((NAME, "1.5", "-0.25 ± 0.1", "changes")))
    assert text.splitlines()[2:] == ["  now 1.5", "  new -0.25 ± 0.1", "  remark changes"]


def test_several_columns_may_say_what_a_row_is():
    text = printed(30, table((NAME, "1.5", "2", "changes")), heading=2)
    assert text == f"rows\n{NAME} 1.5\n  new 2  remark changes\n"


def test_remarks_break_between_words_ahead_of_that():
    remark = "a remark of some words that goes on and on"
    made = table(("gain", "1.5", "2", remark))
    text = printed(60, made, remarks=True)
    assert max(map(len, text.splitlines())) <= 60
    rows = [line.split("│") for line in text.splitlines() if line.startswith("│")]
    assert [cell.strip() for cell in rows[0][1:4]] == ["gain", "1.5", "2"]
    assert " ".join(row[4].strip() for row in rows) == remark
    # A word that is longer than the room would be broken.
    text = printed(60, table(("gain", "1.5", "2", "word" * 12)), remarks=True)
    assert "word" * 12 in text


def test_what_would_steer_the_terminal_is_shown():
    text = printed(20, table((f"{NAME}\x1b[2J", "1", "\x1b[H", "")))
    assert "\x1b" not in text
    assert f"{NAME}\\x1b[2J\n" in text
    assert "new \\x1b[H" in text
