"""The tables of a campaign, as text; the same for the same records, on every machine."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bo_tuner.benchmark.experiment import Case, Experiment
from bo_tuner.benchmark.statistics import Mean, Share, mean
from bo_tuner.benchmark.summary import Record, RowSummary, feasible_at, is_narrow
from bo_tuner.study import Study
from bo_tuner.trials import Value

MARKS = 4
"""Parts of the budget after which the table of convergence looks."""


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def comparison_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Quality of the answers: Table 1 of the paper, and more."""
    header = [
        "row", "held in validation", "truly feasible", "validated objective",
        "validated - training", "true objective of feasible answers", "above the optimum [%]",
        "worst case", "narrow", "cuts (trials + checks)",
    ]  # fmt: skip
    rows = [
        [
            s.row.name,
            _share(s.validated),
            _share(s.feasible),
            _mean(s.validation),
            _mean(s.difference, signed=True),
            _mean(s.objective),
            "" if s.distance is None else _mean(s.distance, digits=1),
            _mean(s.worst),
            f"{s.narrow} of {len(s.answers)}",
            f"{s.cuts.value:.0f} + {s.check_cuts.value:.0f}",
        ]
        for s in summaries
    ]
    return markdown(header, rows)


def published_table(summaries: Sequence[RowSummary]) -> str:
    """Lay out the paper's numbers beside ours; empty if the experiment quotes none."""
    quoted = [s for s in summaries if s.row.published]
    if not quoted:
        return ""
    columns: dict[str, tuple[str, Callable[[RowSummary], str]]] = {
        "feasible": ("feasible", lambda s: _share(s.validated)),
        "objective": ("objective", lambda s: _mean(s.validation)),
        "difference": ("validated - training", lambda s: _mean(s.difference, signed=True)),
        "best": ("best", lambda s: _number(s.best)),
    }
    used = [key for key in columns if any(key in s.row.published for s in quoted)]
    header = ["row"]
    for key in used:
        header += [f"{columns[key][0]}, paper", "here"]
    rows = []
    for s in quoted:
        line = [s.row.name]
        for key in used:
            value = s.row.published.get(key)
            shown = "" if value is None else f"{value:.0%}" if key == "feasible" else f"{value:g}"
            line += [shown, columns[key][1](s)]
        rows.append(line)
    return markdown(header, rows)


def convergence_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Truly feasible incumbents and their objective after parts of the budget (Fig. 4)."""
    marks = [round(case.cuts * (i + 1) / MARKS) for i in range(MARKS)]
    rows = []
    for s in summaries:
        line = [s.row.name]
        for cuts in marks:
            found = feasible_at(s.results, cuts)
            value = f": {np.mean(found):.4f}" if found else ""
            line.append(f"{len(found)} of {case.runs}{value}")
        rows.append(line)
    return markdown(["row", *(f"after {cuts} cuts" for cuts in marks)], rows)


def neighbourhood_table(
    experiment: Experiment,
    case: Case,
    summaries: Sequence[RowSummary],
    done: Mapping[str, Record],
) -> str:
    """Lay out the best parametrizations and their neighbours, each with a verdict (Table 3)."""
    study = case.study
    worst = study.worst_case_constraint
    names = study.search_space().names
    header = ["", *names, "objective", worst.name if worst else "", "feasible", "verdict", "paper"]
    rows = []
    for label, entry, published in _judged(case, summaries, done):
        rows.append(
            [
                f"**{label}**",
                *_point(study, entry["parameters"]),
                *_truth(entry["truth"]),
                _verdict(study, entry),
                _quoted(published),
            ]
        )
        for neighbour in entry["neighbours"]:
            rows.append(
                [
                    "",
                    *_point(study, neighbour["parameters"]),
                    *_truth(neighbour["truth"]),
                    _step(study, entry, neighbour),
                    "",
                ]
            )
    return markdown(header, rows) if rows else ""


def _judged(
    case: Case, summaries: Sequence[RowSummary], done: Mapping[str, Record]
) -> list[tuple[str, Record, Mapping[str, float]]]:
    """Best truly feasible answer of each row, then the points that the experiment names."""
    found: list[tuple[str, Record, Mapping[str, float]]] = []
    sign = 1.0 if case.study.objective.direction == "minimize" else -1.0
    for s in summaries:
        feasible = [answer for answer in s.answers if answer["truth"]["feasible"]]
        if feasible:
            best = min(feasible, key=lambda a: sign * a["truth"]["objective"])
            found.append((f"best of {s.row.name}", best, {}))
    for name, point in case.points.items():
        record = done[f"point/{case.name}/{name}"]
        if not record["failed"]:
            found.append((name, record["result"], point.published))
    return found


def cost_table(experiment: Experiment, done: Mapping[str, Record]) -> str:
    """Optimizer's processor time of a run by number of parameters and trials."""
    rows = []
    for (dimension, trials), seconds in costs(experiment, done).items():
        rows.append([str(dimension), str(trials), _mean(mean(seconds), digits=1)])
    return markdown(["parameters", "trials", "processor time [s]"], rows) if rows else ""


def costs(experiment: Experiment, done: Mapping[str, Record]) -> dict[tuple[int, int], list[float]]:
    """Seconds of the runs by number of parameters and trials."""
    found: dict[tuple[int, int], list[float]] = {}
    if experiment.cost is not None:
        for dimension in experiment.cost.dimensions:
            for seed in range(1, experiment.cost.seeds + 1):
                result = done[f"cost/{dimension}/{seed}"]["result"] or {"trials": [], "seconds": []}
                for trials, seconds in zip(result["trials"], result["seconds"], strict=True):
                    found.setdefault((dimension, trials), []).append(seconds)
    return found


def _share(share: Share) -> str:
    return f"{share.count} of {share.runs} ({share.low:.0%} to {share.high:.0%})"


def _mean(value: Mean, digits: int = 4, signed: bool = False) -> str:
    if value.count == 0:
        return "none"
    shown = f"{value.value:{'+' if signed else ''}.{digits}f}"
    if value.count == 1:
        return shown
    return f"{shown} ({value.low:.{digits}f} to {value.high:.{digits}f})"


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"


def _point(study: Study, parameters: Mapping[str, Value]) -> list[str]:
    return [f"{parameters[name]:.4g}" for name in study.search_space().names]


def _truth(truth: Mapping[str, Any]) -> list[str]:
    feasible = "yes" if truth["feasible"] else "no"
    return [_number(truth["objective"]), _number(truth["worst"]), feasible]


def _verdict(study: Study, entry: Record) -> str:
    if not entry["neighbours"]:
        return ""
    if not entry["truth"]["feasible"]:
        return "infeasible"
    return "narrow" if is_narrow(study, entry["neighbours"]) else "robust"


def _step(study: Study, entry: Record, neighbour: Record) -> str:
    """Tell what a step costs: its relative change of objective and excess over the limit."""
    there, here = neighbour["truth"], entry["truth"]
    if there["objective"] is None or there["worst"] is None or here["objective"] is None:
        return "fails"
    change = there["objective"] / here["objective"] - 1.0
    parts = [f"objective {change:+.0%}"]
    worst = study.worst_case_constraint
    if worst is not None and there["worst"] > worst.upper:
        parts.append(f"limit exceeded by {there['worst'] / worst.upper - 1.0:.0%}")
    return ", ".join(parts) + ("" if neighbour["tolerable"] else ": not tolerable")


def _quoted(published: Mapping[str, float]) -> str:
    parts = []
    if "objective" in published:
        parts.append(f"{published['objective']:g}")
    if "feasible" in published:
        parts.append("feasible" if published["feasible"] else "infeasible")
    return ", ".join(parts)
