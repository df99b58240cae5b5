"""Sections on what the tuner costs: its proposals, workers and records."""

import statistics

from sections.layout import Result

from tuning_benchmark.pages.tables import markdown

COMPARED = ("boundary", "IV", "BoTorch", "BoTorch, every evaluation", "Optuna",
            "Optuna, every evaluation")  # fmt: skip
"""The optimizers of the page; the record has variants of them, and ranges."""


def suggestion(result: Result) -> list[str]:
    """Time of a proposal against other optimizers, and its growth."""
    counts = result["counts"]
    rows = [
        [name, *(_ratio(entry["summary"].get(name)) for entry in counts.values())]
        for name in COMPARED
    ]
    growth = " and ".join(f"trials^{result['growth'][name]:.2f} ({name})" for name in COMPARED[:2])
    return [
        "A proposal on the same data, one thread, as a ratio to that of `boundary` after as many "
        "trials. Each trial has three evaluations: `boundary` models all of them, the others means "
        "and worst cases, or *every evaluation* as a trial of its own. The time grows as "
        f"{growth}.",
        markdown(["trials", *counts], rows),
    ]


def _ratio(summary: Result | None) -> str:
    return f"{summary['median_to_boundary']:.2f}" if summary else ""


def library(result: Result) -> list[str]:
    """Lines, import and overhead of the interface from Python."""
    overhead = {name: statistics.median(v) for name, v in result["overhead"].items()}
    return [
        f"The smallest program that tunes a function within a limit, and certifies the result, has "
        f"{result['lines']} lines. Beyond NumPy, `import bo_tuner` takes "
        f"{statistics.median(result['import']['bo_tuner']):.2f} s, and all of its names "
        f"{statistics.median(result['import']['names']):.2f} s.",
        f"Of a function that takes 1 ms, with {result['calls']} calls, one thread:",
        markdown(
            ["", "time of the processor for a call, beyond the function's [ms]"],
            [[name, f"{1e3 * seconds:.1f}"] for name, seconds in overhead.items()],
        ),
        "Optuna: ask and tell with its default sampler, trials in memory.",
    ]


WORKERS_HEADER = ["workers", "start [s]"] + [
    heading
    for command in ("tune", "validate", "both")
    for heading in (f"{command} [s]", "times as fast", "beyond the start")
]


def speedups(rows: list[Result]) -> list[list[str]]:
    """Return for each number of workers its times, and how many times as fast it is as one."""
    return [_speedup(row, rows[0]) for row in rows]


def _speedup(row: Result, one: Result) -> list[str]:
    cells = [f"{row['workers']}", f"{row['start'] - one['start']:.1f}"]
    for commands in (("tune",), ("validate",), ("tune", "validate")):
        taken, alone = (sum(each[name] for name in commands) for each in (row, one))
        starts = [len(commands) * each["start"] for each in (row, one)]
        beyond = (alone - starts[1]) / (taken - starts[0])
        cells += [f"{taken:.0f}", f"{alone / taken:.1f}", f"{beyond:.1f}"]
    return cells


def workers(result: Result) -> list[str]:
    """How many times as fast several workers are."""
    parts = [
        f"`tune` with {result['trials']} trials and `validate`, on an object that sleeps in each "
        f"evaluation; {result['window']} trials are planned at once. *Start*: how much longer the "
        "start takes than with one worker; *beyond the start*: without it. The machine has "
        f"{result['cores']} cores and a load average of {result['load_before']:.1f} by other "
        "programs.",
    ]
    for item in result["sleeps"]:
        parts += [
            f"Evaluations of {item['sleep']:g} s:",
            markdown(WORKERS_HEADER, speedups(item["rows"])),
        ]
    return parts


def playing(result: Result) -> list[str]:
    """Tell how many runs in a minute a bag gives."""
    times = result["runs"]
    in_lockstep, (by_clock, *_) = times.values()
    usual = statistics.median(in_lockstep)
    return [
        f"A drive of {result['seconds']:g} s played to the filter of the example, the new start of "
        f"the node for each run included: {60.0 / usual:.2f} runs in a minute in lockstep (from "
        f"{min(in_lockstep):.0f} to {max(in_lockstep):.0f} s each, on a computer that had other "
        f"work), {60.0 / by_clock:.2f} at rate 1, as any player that keeps the time of the bag has "
        f"it: {by_clock / usual:.1f} times as many.",
    ]


def recording(result: Result) -> list[str]:
    """Cost of recording a cut."""
    low, high = result["ratio_quartiles"]
    return [
        f"Time of a cut with recording over one without: median {result['ratio_median']:.2f}, "
        f"quartiles {low:.2f} to {high:.2f}; {result['missing_messages']} messages missing.",
    ]
