"""A verdict in the terminal: its words, a table of its numbers, and what to do next."""

from collections.abc import Iterator, Mapping
from math import isfinite
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bo_tuner import text
from bo_tuner.evidence.differences import CONFIDENCE
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.verdict import Verdict
from bo_tuner.evidence.words.limits import in_words
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.quantities import details
from bo_tuner.evidence.words.verdict import bases, headline, keeps, sentences
from bo_tuner.study.study import Study
from bo_tuner.terminal import from_here, print_line, print_table
from bo_tuner.trials import Value


def print_verdict(
    console: Console, study: Study, verdict: Verdict, tuned: Mapping[str, Value]
) -> None:
    """Print the verdict with its numbers."""
    console.print(headline(verdict))
    for sentence in sentences(verdict):
        print_line(console, f"  {sentence}", "  ")
    print_table(console, verdict_table(study, verdict, tuned))
    for line in verdict_notes(verdict):
        print_line(console, line, "  ")


def print_next_steps(console: Console, verdict: Verdict, run: Path) -> None:
    """Print the commands that come next, if there are any, as a list below a heading.

    Their purposes are aligned; on a narrow terminal each is below its command.
    """
    steps = next_steps(verdict, str(from_here(run)))
    if steps:
        console.print("next:")
    width = max((len(step.command) for step in steps), default=0)
    lines = [f"  {step.command:<{width}}  {step.purpose}" for step in steps]
    if console.is_terminal and max(map(len, lines), default=0) > console.width:
        lines = [line for step in steps for line in (f"  {step.command}", f"      {step.purpose}")]
    for line in lines:
        console.print(line, soft_wrap=True)


def verdict_table(study: Study, verdict: Verdict, tuned: Mapping[str, Value]) -> Table:
    """Make a table of the parameters and of the numbers of a verdict."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("")
    for name in ("default", "tuned", "difference", "limit"):
        table.add_column(name, justify="right")
    defaults, tuned = map(study.on_screen, (study.search_space().defaults, tuned))
    for name, item in study.parameters.items():
        now, new = defaults[name], tuned[name]
        table.add_row(
            text.with_unit(item.title, item.unit), text.shown(now), text.shown(new), "", ""
        )
    table.add_section()
    for quantity in verdict.quantities:
        table.add_row(
            text.with_unit(quantity.label, quantity.unit),
            *quantity.values_in_words,
            _difference(quantity),
            quantity.limit_in_words,
        )
    table.add_section()
    table.add_row("keeps all limits", *keeps(verdict), "", "")
    return table


def verdict_notes(verdict: Verdict) -> Iterator[str]:
    """Yield what the table needs to be read: the limits in detail, and what ± means."""
    yield from bases(verdict)
    for quantity in verdict.quantities:
        limit = quantity.limit_verdict
        if limit is not None:
            parts = filter(None, (in_words(limit), details(quantity)))
            yield f"{quantity.label}: {'; '.join(parts)}"
    yield (
        f"difference: tuned minus default; ± is half the width of its {100.0 * CONFIDENCE:g} % "
        "confidence interval"
    )


def _difference(quantity: Quantity) -> str:
    difference = quantity.difference
    if difference is None or not isfinite(difference.mean):
        return "–"
    half = 0.5 * (difference.high - difference.low)
    return f"{difference.mean:+.3g} ± {half:.2g}" if isfinite(half) else f"{difference.mean:+.3g}"
