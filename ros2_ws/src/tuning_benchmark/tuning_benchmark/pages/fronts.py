"""The section of the page on Pareto fronts, from the record of `tuning_benchmark.fronts`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tuning_benchmark.pages.page import COMMIT_DIGITS, Section
from tuning_benchmark.pages.statistics import Mean, difference, mean
from tuning_benchmark.pages.tables import markdown

RECORD = "fronts.json"
REFERENCE = "IV"
"""Key of the optimizer that others are compared with."""
TITLES = {
    "boundary": "`boundary`",
    "IV": "Algorithm IV, ParEGO weights",
    "II": "random search (Algorithm II)",
    "NSGA-II": "Optuna NSGA-II",
    "TPE": "Optuna TPE",
}

READING = """\
Two objectives under a robust limit, with noise and two contexts. All optimizers have the same
initial design, number of trials and second stage. The hypervolume is that of the true costs of the
points that an optimizer recommends, relative to the true front: 1 is all of it, and a finite number
of points always leaves something. A point that violates the limit in truth counts nothing. ± is
half the width of a 95 % interval; differences are of runs with the same seed.
"""


def section(record: Mapping[str, Any], path: str) -> Section:
    """Lay out the comparison; `path` is that of the record, relative to the page."""
    about = record["provenance"]
    rows = [
        [parameters, *_row(TITLES[name], runs, problem.get(REFERENCE, ()))]
        for parameters, problem in record["problems"].items()
        for name, runs in problem.items()
    ]
    header = [
        "parameters", "optimizer", "hypervolume of the front", f"Algorithm {REFERENCE} minus it",
        "of all trials", "points", "violating, in all runs", "trials", "evaluations",
    ]  # fmt: skip
    origin = (
        f"*`python -m tuning_benchmark.fronts`, commit {about['commit'][:COMMIT_DIGITS]}, seeds 1 "
        f"to {record['runs']}, {about['machine']}, {', '.join(about['versions'])}, "
        f"[record]({path}).*"
    )
    text = "\n\n".join([READING.strip(), markdown(header, rows), origin])
    return Section("Pareto fronts", text)


def _row(title: str, runs: list[dict[str, Any]], reference: list[dict[str, Any]]) -> list[str]:
    volumes, first = ({item["seed"]: item["volume"] for item in some} for some in (runs, reference))
    return [
        title,
        _shown(mean(list(volumes.values()))),
        _shown(difference(first, volumes)) if first and runs is not reference else "",
        _shown(mean([item["seen"] for item in runs])),
        f"{np.mean([item['points'] for item in runs]):.1f}",
        str(sum(item["violating"] for item in runs)),
        str(runs[0]["trials"]),
        f"{np.mean([item['evaluations'] for item in runs]):.0f}",
    ]


def _shown(value: Mean) -> str:
    return f"{value.value:.3f} ± {value.high - value.value:.3f}"
