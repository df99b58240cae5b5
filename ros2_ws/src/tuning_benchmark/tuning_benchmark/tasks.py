"""A campaign as tasks that do not depend on each other, and how one is carried out."""

import dataclasses
import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from threadpoolctl import threadpool_limits

from bo_tuner.errors import RunError
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark import sources
from tuning_benchmark.calibration import calibrate
from tuning_benchmark.cost import cost_of_run
from tuning_benchmark.experiment import Case, Experiment
from tuning_benchmark.experiment_parts import Cost, Row
from tuning_benchmark.fields import axes, surrogate_fields, true_fields
from tuning_benchmark.machine import machine
from tuning_benchmark.neighbours import judge_neighbours
from tuning_benchmark.runs import RunSize, run
from tuning_benchmark.truth import truth_of, verdict_record


@dataclass(frozen=True)
class Task:
    """One piece of a campaign.

    Attributes
    ----------
    name
        Unique in its campaign, such as ``run/benchmark/IV/3``.
    function, arguments
        What it calls; it returns what JSON takes.
    modules
        Roots of the code that it runs.
    version
        Digest of that code and of the arguments.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...]
    modules: tuple[str, ...]
    version: str


def tasks_of(experiment: Experiment) -> list[Task]:
    """List the tasks of an experiment; runs of one seed stand together."""
    tasks: list[Task] = []
    for case in experiment.cases.values():
        tasks += _runs(case, experiment.judge)
        tasks += _points(case, experiment.judge)
        tasks += _fields(case, experiment.judge)
    if experiment.calibration is not None:
        modules = _modules(experiment.calibration.study)
        tasks.append(_task("calibration", calibrate, (experiment.calibration,), modules))
    if experiment.cost is not None:
        tasks += _costs(experiment.cost)
    return tasks


def carry_out(task: Task) -> dict[str, Any]:
    """Do a task; its record. What it raises is the reason why it failed, and no lost campaign.

    Raises
    ------
    RunError
        If this process cannot do it: it has other code or libraries than the one that asks.
    """
    try:
        version = _version(task.modules, task.name, task.arguments)
        for module in task.modules:
            importlib.import_module(module)
    except ImportError as error:
        raise RunError(f"{task.name}: {machine()} cannot import what it needs: {error}") from error
    if version != task.version:
        found = ", ".join(sources.versions(task.modules))
        raise RunError(f"{task.name}: {machine()} has another version of the code, or of {found}")
    begin = time.monotonic()
    result: dict[str, Any] | None = None
    reason = ""
    try:
        # One thread each: the tasks are what runs in parallel. Limits hold for what is loaded.
        with threadpool_limits(1):
            result = task.function(*task.arguments)
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
    return {
        "task": task.name,
        "version": version,
        "failed": reason,
        "result": result,
        "wall_seconds": round(time.monotonic() - begin, 3),
        "about": {
            "machine": machine(),
            "versions": ", ".join(sources.versions(task.modules)),
            "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        },
    }


def judge_point(study: Study, judge: str, point: Mapping[str, Value]) -> dict[str, Any]:
    """Judge a parametrization, given by its tuned parameters, and its neighbours."""
    space = study.search_space()
    parameters = space.to_parameters(space.to_cube(point)) | dict(point)
    truth = truth_of(study, judge)
    verdict = truth.verdict(parameters)
    return {
        "parameters": parameters,
        "truth": verdict_record(verdict),
        "neighbours": judge_neighbours(truth, parameters, verdict),
    }


def _runs(case: Case, judge: str) -> list[Task]:
    tasks = []
    for seed in range(1, case.runs + 1):
        for row in case.rows.values():
            # What the paper says of the row does not change its runs.
            bare = dataclasses.replace(row, published={})
            arguments = (case.study, bare, seed, _size(case, row), judge)
            modules = [*_modules(case.study), _module(judge), _module(row.optimizer)]
            tasks.append(_task(f"run/{case.name}/{row.name}/{seed}", run, arguments, modules))
    return tasks


def _points(case: Case, judge: str) -> list[Task]:
    modules = [*_modules(case.study), _module(judge)]
    tasks = []
    for name, point in case.points.items():
        arguments = (case.study, judge, dict(point.parameters))
        tasks.append(_task(f"point/{case.name}/{name}", judge_point, arguments, modules))
    return tasks


def _fields(case: Case, judge: str) -> list[Task]:
    figure = case.surrogates
    if figure is None:
        return []
    study = case.study
    modules = [*_modules(study), _module(judge)]
    row = dataclasses.replace(case.rows[figure.row], published={})
    arguments = (study, row, figure.seed, _size(case, row), figure.points)
    tasks = [_task(f"surrogates/{case.name}", surrogate_fields, arguments, modules)]
    for first in axes(study, figure.points)[0]:
        given = (study, judge, figure.points, first)
        tasks.append(_task(f"truth/{case.name}/{first}", true_fields, given, modules))
    return tasks


def _costs(cost: Cost) -> list[Task]:
    tasks = []
    for dimension in cost.dimensions:
        longest = dimension == min(cost.dimensions)
        marks = sorted({cost.compared_trials, *(cost.trials if longest else ())})
        for seed in range(1, cost.seeds + 1):
            arguments = (cost.algorithm, dimension, seed, marks)
            tasks.append(_task(f"cost/{dimension}/{seed}", cost_of_run, arguments, []))
    return tasks


def _size(case: Case, row: Row) -> RunSize:
    initial = case.initial_trials or case.study.budget.initial_trials
    return RunSize(case.budget(row), case.reserved_evaluations, initial)


def _task(
    name: str,
    function: Callable[..., dict[str, Any]],
    arguments: tuple[Any, ...],
    modules: list[str],
) -> Task:
    roots = (function.__module__, *(module for module in modules if module))
    return Task(name, function, arguments, roots, _version(roots, name, arguments))


def _version(roots: tuple[str, ...], name: str, arguments: tuple[Any, ...]) -> str:
    return sources.digest(roots, name, repr(arguments))


def _modules(study: Study) -> list[str]:
    return [_module(node.object) for node in study.nodes.values() if node.object]


def _module(name: str) -> str:
    return name.partition(":")[0]
