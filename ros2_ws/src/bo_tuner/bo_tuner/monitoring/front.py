"""The Pareto front in the terminal."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bo_tuner.study.study import Study
from bo_tuner.study.titles import mean_title
from bo_tuner.terminal import print_line, print_table
from bo_tuner.text import percent, with_unit
from bo_tuner.tuning.front import CONFIDENCE


def print_front(
    console: Console,
    study: Study,
    front: Sequence[Mapping[str, Any]],
    result: int | None,
    run: Path,
) -> None:
    """Print the front with a mark on the result."""
    if not front:
        print_line(
            console,
            "each parameter set that is likely within limits broke a limit in its own test runs, "
            "so there is no Pareto front",
            "",
        )
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("trial", justify="right")
    for objective in study.objectives:
        metric = study.metrics[objective.metric]
        table.add_column(with_unit(mean_title(metric.title), metric.unit), justify="right")
    table.add_column("likely within limits", justify="right")
    table.add_column("")
    for point in front:
        table.add_row(
            str(point["trial"]),
            *(_in_words(point["means"][item.metric]) for item in study.objectives),
            percent(point["feasibility"]),
            "result" if point["trial"] == result else "",
        )
    models = ", by the models of all test runs" if front[0]["modelled"] else ""
    print_line(
        console,
        f"Pareto front of the trials{models}, ± half the width of a "
        f"{100 * CONFIDENCE:g} % interval; for another point: "
        f"validate {shlex.quote(str(run))} --trial N",
        "",
    )
    print_table(console, table)


def _in_words(mean: Mapping[str, Any]) -> str:
    error = "" if mean["error"] is None else f" ± {mean['error']:.2g}"
    return f"{mean['value']:.4g}{error}"
