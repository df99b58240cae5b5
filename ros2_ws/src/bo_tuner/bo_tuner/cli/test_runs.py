"""What ``check`` shows of its test runs."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table

from bo_tuner.cli.found import note
from bo_tuner.evidence.check import DefaultBeyond, FarOff, MeanWithoutRange, Spread
from bo_tuner.evidence.limit_proof import proof_of
from bo_tuner.evidence.words.check import limits as limits_in_words
from bo_tuner.metrics.recording import Recording
from bo_tuner.monitoring.display import plain_console
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.ranges import outside
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.trials import Evaluation

WIDTH, LEAST_WIDTH = 60, 10
"""Characters of a plot, where there is room, and at least."""
BESIDE_PLOT = 44
"""Characters of the other columns of the table of signals, and of its lines, but for the names."""
LARGE_SPREAD = 0.2
"""Difference of two equal runs, of the larger value, from which on it is worth a note."""
SMALL = 0.01
"""Share of a limit below which values may differ by as much as they do just there."""
FAR_OFF = 20.0
"""Ratio of a limit and the value of the default from which on one may be in another unit."""
BARS = " ▁▂▃▄▅▆▇█"


def show_signals(recording: Recording, number: int) -> None:
    """Show the signals of a run, and which one it is."""
    console = plain_console()
    all_names = (*recording.signals, *recording.messages)
    names = max((len(name) for name in all_names), default=0)
    width = min(max(console.width - BESIDE_PLOT - max(names, len("signal")), LEAST_WIDTH), WIDTH)
    table = Table(title=f"signals of run {number}, {recording.end:.3g} s", title_justify="left")
    for column in ("signal", "messages", "least", "over the run", "largest"):
        table.add_column(column)
    for name, seen in recording.signals.items():
        if not len(seen.time):
            table.add_row(name, "0", "", "", "")
            continue
        low, high = float(np.min(seen.value)), float(np.max(seen.value))
        count = f"{seen.messages}"
        table.add_row(
            name,
            count,
            f"{low:.4g}",
            plot(seen.time, seen.value, recording.end, width),
            f"{high:.4g}",
        )
    for name, heard in recording.messages.items():
        table.add_row(name, f"{heard.messages}", "", f"whole messages, {heard.type}", "")
    if all_names:
        print_table(console, table)


def plot(time: ArrayLike, value: ArrayLike, end: float, width: int = WIDTH) -> str:
    """Draw a signal in a line of bars, between its least and its largest value."""
    at = np.linspace(0.0, end, width)
    held = np.asarray(value)[np.clip(np.searchsorted(time, at, side="right") - 1, 0, None)]
    low, high = float(np.min(value)), float(np.max(value))
    if not math.isfinite(high - low):
        return "not finite"
    height = (held - low) / (high - low) if high > low else np.full(width, 0.5)
    return "".join(BARS[1 + round(float(h) * (len(BARS) - 2))] for h in height)


def show_metrics(study: Study, done: Sequence[Evaluation]) -> None:
    """Show the metrics of complete runs, and say what asks for a look."""
    table = Table(title="metrics of the default", title_justify="left")
    for column in ("metric", "unit", *(f"run {e.index + 1}" for e in done), "limit", "violations"):
        table.add_column(column)
    notes: list[object] = []
    for name, metric in study.metrics.items():
        values = [e.outcome.metrics[name] for e in done]
        limits = [item for item in study.constraints.values() if item.metric == name]
        beyond = sum(any(item.violations(value) for item in limits) for value in values)
        cells = (f"{value:.4g}" for value in values)
        count = f"{beyond} of {len(values)}" if limits else ""
        table.add_row(name, metric.unit, *cells, limits_in_words(limits), count)
        if beyond:
            notes.append(DefaultBeyond(name, tuple(limits), metric.unit))
        if name not in study.relative_metrics:
            notes += [far_off(item, metric.unit, values) for item in limits]
        notes += [MeanWithoutRange(i) for i in limits if proof_of(i).assumes_noise(metric.range)]
        # Equal runs may well have another wind.
        if name not in study.measured:
            notes.append(spread(name, values, [abs(item.limit) for item in limits]))
    print_table(plain_console(), table)
    note(*(fact for fact in [outside(study.metrics, done), *notes] if fact is not None))


def far_off(constraint: Constraint, unit: str, values: Sequence[float]) -> FarOff | None:
    """Return that a limit is far from what the default reaches; None if it is not.

    It may well be meant, but 7 where the default reaches 0.036 rad are rather degrees.
    """
    reached = float(np.median(np.abs(values)))
    limit = abs(constraint.limit)
    if not reached or not limit or 1 / FAR_OFF < limit / reached < FAR_OFF:
        return None
    return FarOff(constraint, unit, reached)


def spread(name: str, values: Sequence[float], limits: Sequence[float]) -> Spread | None:
    """Return that a metric differs much between equal runs; None if it does not.

    Such noise is possible, but more often one run did not begin as the other. What is small beside
    its limits may differ.
    """
    largest = max([*map(abs, values), *(SMALL * limit for limit in limits)])
    width = max(values) - min(values)
    return Spread(name, width) if width > LARGE_SPREAD * largest else None
