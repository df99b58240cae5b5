"""The part of an experiment that is on record, for a page before its campaign has ended."""

import dataclasses
from collections.abc import Callable, Container
from itertools import count, takewhile

from bo_tuner.errors import OutputError
from tuning_benchmark.experiments.experiment import Case, Cost, Experiment
from tuning_benchmark.experiments.task_names import (
    CALIBRATION,
    cost_task,
    point_task,
    run_task,
    surrogates_task,
    truth_task,
)


def on_record(experiment: Experiment, done: Container[str]) -> tuple[Experiment, list[str]]:
    """Reduce an experiment to what is on record.

    Parameters
    ----------
    experiment
        The whole experiment.
    done
        Names of the tasks on record.

    Returns
    -------
    experiment
        With the first runs of each case that all its rows have, and without what lacks a task, such
        as a row without any run.
    missing
        What was left out, in words; empty if nothing was.

    Raises
    ------
    OutputError
        If no case has a run on record.
    """
    missing: list[str] = []
    cases = {}
    for name, case in experiment.cases.items():
        reduced = _case(case, done, missing)
        if reduced is not None:
            cases[name] = reduced
    if not cases:
        raise OutputError(f"no run of {experiment.name} is on record")
    calibration = experiment.calibration if CALIBRATION in done else None
    if calibration is not experiment.calibration:
        missing.append("the calibration")
    cost = experiment.cost
    if cost is not None:
        cost = _cost(cost, done, missing)
    return dataclasses.replace(experiment, cases=cases, calibration=calibration, cost=cost), missing


def _case(case: Case, done: Container[str], missing: list[str]) -> Case | None:
    rows = {k: v for k, v in case.rows.items() if run_task(case.name, k, 1) in done}
    if not rows:
        missing.append(f"all runs of {case.name}")
        return None
    missing += [f"all runs of {row} of {case.name}" for row in case.rows if row not in rows]

    def whole(seed: int) -> bool:
        return all(run_task(case.name, row, seed) in done for row in rows)

    runs = _first(whole, case.runs)
    if runs < case.runs:
        missing.append(f"{case.runs - runs} of {case.runs} runs of {case.name}")
    points = {k: v for k, v in case.points.items() if point_task(case.name, k) in done}
    if len(points) < len(case.points):
        missing.append(f"{len(case.points) - len(points)} judged points of {case.name}")
    surrogates = case.surrogates
    if surrogates is not None and surrogates.row in rows:
        columns = [truth_task(case.name, x) for x in surrogates.axes(case.study)[0]]
        if any(name not in done for name in (surrogates_task(case.name), *columns)):
            missing.append(f"the surrogates of {case.name}")
            surrogates = None
    else:
        surrogates = None
    return dataclasses.replace(case, rows=rows, runs=runs, points=points, surrogates=surrogates)


def _cost(cost: Cost, done: Container[str], missing: list[str]) -> Cost | None:
    def whole(seed: int) -> bool:
        return all(cost_task(dimension, seed) in done for dimension in cost.dimensions)

    seeds = _first(whole, cost.seeds)
    if seeds < cost.seeds:
        missing.append(f"{cost.seeds - seeds} of {cost.seeds} runs of the cost")
    return dataclasses.replace(cost, seeds=seeds) if seeds else None


def _first(whole: Callable[[int], bool], most: int) -> int:
    """Count the seeds from 1 on, up to `most`, until one is not whole."""
    return sum(1 for _ in takewhile(lambda seed: seed <= most and whole(seed), count(1)))
