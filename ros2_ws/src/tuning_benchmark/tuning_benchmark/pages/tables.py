"""The tables of a campaign, as text; the same for the same records, on every machine."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.experiments.experiment import Case, Cost
from tuning_benchmark.experiments.task_names import cost_task, point_task
from tuning_benchmark.pages.statistics import Mean, Share, difference, mcnemar, mean
from tuning_benchmark.pages.summary import Record, RowSummary, feasible_at, is_narrow

Columns = dict[str, Callable[[RowSummary], str]]
"""Headings of a table of rows, and what a row shows below each."""

MARKS = 4
"""Number of equal parts of the budget after which the convergence table has a column."""

SKEWED = 0.05
"""Where mean and median differ by more than this part of the mean, the median is shown too."""


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out a Markdown table.

    Raises
    ------
    ValueError
        If a row has not as many cells as the header.
    """
    rows = list(rows)
    if any(len(row) != len(header) for row in rows):
        raise ValueError(f"each row of a table has {len(header)} cells: {', '.join(header)}")
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def overview_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Lay out what matters of a case in one table, without columns of which nothing is known."""
    columns: Columns = {
        "row": lambda s: s.row.name,
        "truly feasible": lambda s: _share(s.feasible),
        "objective": lambda s: _mean(s.objective),
    }
    if any(s.distance is not None for s in summaries):
        columns["above the optimum [%]"] = lambda s: _mean(s.distance or mean([]), digits=1)
    if any(s.regrets for s in summaries):
        columns["regret at equal margin [%]"] = lambda s: _mean(
            mean(list(s.regrets.values())), digits=1
        )
    if any(s.kept for s in summaries):
        columns["within the limit"] = _kept
    if any(s.distance is not None for s in summaries):
        columns["near"] = lambda s: f"{_near(s)} of {case.runs}, {_until_near(s)}"
    columns["evaluations"] = _evaluations
    columns |= _published(summaries)
    return markdown(list(columns), [[shown(s) for shown in columns.values()] for s in summaries])


def cases_table(cases: Iterable[tuple[Case, Sequence[RowSummary]]]) -> str:
    """Lay out several cases in one table: what was found, and what it took."""
    header = [
        "case", "row", "truly feasible", "above the optimum [%]", "within the limit", "evaluations",
    ]  # fmt: skip
    rows = [
        [
            "" if k else case.title,
            s.row.name,
            _share(s.feasible),
            _mean(s.distance, digits=1) if s.distance else "",
            _kept(s),
            _evaluations(s),
        ]
        for case, summaries in cases
        for k, s in enumerate(summaries)
    ]
    return markdown(header, rows)


def _counts(s: RowSummary, first: RowSummary) -> str:
    """Count the seeds with a feasible answer in one of two rows only, with McNemar's test."""
    theirs, mine = s.feasible_objectives.keys(), first.feasible_objectives.keys()
    only, only_first = len(theirs - mine), len(mine - theirs)
    return f"{only} : {only_first} (p = {mcnemar(only, only_first):.2g})"


def _near(s: RowSummary) -> int:
    """Count the runs that were near the optimum for good."""
    return int(sum(np.isfinite(list(s.reached.values()))))


def _until_near(s: RowSummary) -> str:
    """Lay out the median of the evaluations until runs were near the optimum for good."""
    median = float(np.median(list(s.reached.values()))) if s.reached else np.inf
    return f"{median:.0f}" if np.isfinite(median) else "never"


def _kept(s: RowSummary) -> str:
    """Lay out the share of runs within the limit in the answers' worst contexts."""
    kept = list(s.kept.values())
    return f"{np.mean(kept):.3f}, lowest {min(kept):.3f}" if kept else "not judged"


def comparison_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Quality of the answers: Table 1 of the paper, and more."""
    header = [
        "row", "held in validation", "truly feasible", "validated objective",
        "validated - training", "true objective of feasible answers", "above the optimum [%]",
        "worst case", "narrow", "evaluations (trials + checks)",
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
            _evaluations(s),
        ]
        for s in summaries
    ]
    return markdown(header, rows)


def fair_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Regret at equal margin, realized probability and speed; empty if none of it is known."""
    if not any(s.regrets or s.kept or s.distance for s in summaries):
        return ""
    header = [
        "row", "truly feasible", "regret at equal margin [%]", "realized probability", "near",
        "median evaluations until near",
    ]  # fmt: skip
    rows = []
    for s in summaries:
        rows.append(
            [
                s.row.name,
                _share(s.feasible),
                _mean(mean(list(s.regrets.values())), digits=1),
                _kept(s),
                f"{_near(s)} of {case.runs}" if s.distance else "",
                _until_near(s) if s.distance else "",
            ]
        )
    return markdown(header, rows)


def paired_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Compare each row with the first by pairs of runs with one seed; empty for a single row."""
    if len(summaries) < 2:
        return ""
    first, *others = summaries
    rows = [
        [
            s.row.name,
            _counts(s, first),
            _mean(difference(s.feasible_objectives, first.feasible_objectives), signed=True),
            _mean(difference(s.regrets, first.regrets), digits=1, signed=True),
        ]
        for s in others
    ]
    header = [
        f"row less {first.row.name}", f"feasible only in the row : only in {first.row.name}",
        "objective", "regret at equal margin [%]",
    ]  # fmt: skip
    return markdown(header, rows)


def published_table(summaries: Sequence[RowSummary]) -> str:
    """Lay out the paper's numbers beside ours; empty if the experiment quotes none."""
    quoted = [s for s in summaries if s.row.published]
    columns = _published(quoted)
    header = ["row", *columns]
    rows = [[s.row.name, *(shown(s) for shown in columns.values())] for s in quoted]
    return markdown(header, rows) if quoted else ""


def _published(summaries: Sequence[RowSummary]) -> Columns:
    """Return the columns of what the paper says of rows, each followed by ours."""
    ours: dict[str, tuple[str, Callable[[RowSummary], str]]] = {
        "feasible": ("held", lambda s: _share(s.validated)),
        "objective": ("validated objective", lambda s: _mean(s.validation)),
        "difference": ("validated - training", lambda s: _mean(s.difference, signed=True)),
        "best": ("best validated", lambda s: _number(s.best)),
    }
    columns: Columns = {}
    for key, (name, shown) in ours.items():
        if any(key in s.row.published for s in summaries):
            columns[f"{name}, paper"] = partial(_printed, key=key)
            columns[f"{name}, here"] = shown
    return columns


def convergence_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Truly feasible incumbents and their objective after parts of the budget (Fig. 4).

    The answers are the last column: with the checks a run may exceed the budget.
    """
    marks = [round(case.evaluations * (i + 1) / MARKS) for i in range(MARKS)]
    rows = []
    for s in summaries:
        objectives = [feasible_at(s.results.values(), evaluations) for evaluations in marks]
        objectives.append(list(s.feasible_objectives.values()))
        rows.append([s.row.name, *(_count_and_mean(values, case.runs) for values in objectives)])
    return markdown(
        ["row", *(f"after {evaluations} evaluations" for evaluations in marks), "answer"], rows
    )


def ranked_table(case: Case, summaries: Sequence[RowSummary]) -> str:
    """Lay out the answers of Algorithm IV's rule to others' trials; empty without any."""
    rows = []
    for s in summaries:
        choices = [result["ranked"] for result in s.results.values()]
        truths = [ranked["truth"] for ranked in choices if ranked is not None]
        if truths:
            ranked = [truth["objective"] for truth in truths if truth["feasible"]]
            own = list(s.feasible_objectives.values())
            rows.append(
                [s.row.name, _count_and_mean(ranked, case.runs), _count_and_mean(own, case.runs)]
            )
    header = ["row", "Algorithm IV's choice, truly feasible", "own choice, truly feasible"]
    return markdown(header, rows) if rows else ""


def neighbourhood_table(
    case: Case,
    summaries: Sequence[RowSummary],
    done: Mapping[str, Record],
    neighbours: bool = True,
) -> str:
    """Lay out the best parameter sets, and perhaps their neighbours, with verdicts (Table 3)."""
    study = case.study
    worst = next(iter(study.worst_case_constraints), None)
    names = study.search_space().names
    header = ["", *names, "objective", worst.name if worst else "", "feasible", "verdict", "paper"]
    rows = []
    for judged in _judged(case, summaries, done):
        entry = judged.entry
        rows.append(
            [
                f"**{judged.label}**",
                *_point(study, entry["parameters"]),
                *_truth(entry["truth"]),
                _verdict(study, entry),
                _quoted(judged.published),
            ]
        )
        for neighbour in entry["neighbours"] if neighbours and judged.listed else ():
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


@dataclass(frozen=True)
class _Judged:
    """A parameter set of Table 3, and whether its neighbours are listed below it."""

    label: str
    entry: Record
    listed: bool = True
    published: Mapping[str, float] = field(default_factory=dict)


def _judged(
    case: Case, summaries: Sequence[RowSummary], done: Mapping[str, Record]
) -> list[_Judged]:
    """Best answer of each row by its validation, then the points of the experiment."""
    judged = []
    sign = case.study.objective.sign
    for s in summaries:
        if s.held:
            best = min(s.held.values(), key=lambda a: sign * a["validation"]["objective"])
            judged.append(_Judged(f"best of {s.row.name}", best))
    for name, point in case.points.items():
        record = done[point_task(case.name, name)]
        if not record["failed"]:
            judged.append(_Judged(name, record["result"], point.neighbours, point.published))
    return judged


def cost_table(cost: Cost, done: Mapping[str, Record]) -> str:
    """Optimizer's processor time of a run by number of parameters and trials."""
    rows = []
    for (dimension, trials), seconds in costs(cost, done).items():
        shown = _mean(mean(list(seconds.values())), digits=1)
        rows.append([str(dimension), str(trials), shown])
    return markdown(["parameters", "trials", "processor time [s]"], rows) if rows else ""


def costs(cost: Cost, done: Mapping[str, Record]) -> dict[tuple[int, int], dict[int, float]]:
    """Seconds of the runs by seed, for each number of parameters and trials."""
    seconds_by_size: dict[tuple[int, int], dict[int, float]] = {}
    for dimension in cost.dimensions:
        for seed in range(1, cost.seeds + 1):
            result = done[cost_task(dimension, seed)]["result"] or {"trials": [], "seconds": []}
            for trials, seconds in zip(result["trials"], result["seconds"], strict=True):
                seconds_by_size.setdefault((dimension, trials), {})[seed] = seconds
    return seconds_by_size


def _evaluations(s: RowSummary) -> str:
    if not s.results:
        return "none"
    return (
        f"{s.evaluations.value:.0f} + {s.check_evaluations.value:.0f}, at most {s.most_evaluations}"
    )


def _printed(s: RowSummary, key: str) -> str:
    """Lay out a number of the paper; empty if it has none for the row."""
    value, runs = s.row.published.get(key), s.row.published.get("runs")
    if value is None:
        return ""
    if key != "feasible":
        return f"{value:g}"
    return f"{value:.0%}" if runs is None else f"{value:.0%} of {runs:g}"


def _count_and_mean(objectives: Sequence[float], runs: int) -> str:
    """Count the feasible ones, with their mean, and the median if that differs clearly."""
    counted = f"{len(objectives)} of {runs}"
    if not objectives:
        return counted
    average, median = float(np.mean(objectives)), float(np.median(objectives))
    skewed = abs(average - median) > SKEWED * abs(average)
    return f"{counted}: {average:.4f}" + (f" (median {median:.4f})" if skewed else "")


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
    if not entry["truth"]["feasible"]:
        return "infeasible"
    if not entry["neighbours"]:
        return ""
    return "narrow" if is_narrow(study, entry["neighbours"]) else "robust"


def _step(study: Study, entry: Record, neighbour: Record) -> str:
    """Describe a step: its relative change of the objective and excess over the limit."""
    moved, truth = neighbour["truth"], entry["truth"]
    if moved["objective"] is None or moved["worst"] is None or truth["objective"] is None:
        return "fails"
    change = moved["objective"] / truth["objective"] - 1.0
    parts = [f"objective {change:+.0%}"]
    for worst in study.worst_case_constraints:
        if worst.violations(moved["worst"]):
            parts.append(f"limit exceeded by {worst.excess(moved['worst']):.0%}")
    return ", ".join(parts) + ("" if neighbour["tolerable"] else ": not tolerable")


def _quoted(published: Mapping[str, float]) -> str:
    parts = []
    if "objective" in published:
        parts.append(f"{published['objective']:g}")
    if "feasible" in published:
        parts.append("feasible" if published["feasible"] else "infeasible")
    return ", ".join(parts)
