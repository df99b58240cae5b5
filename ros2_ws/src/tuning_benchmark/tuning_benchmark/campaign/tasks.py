"""A campaign as independent tasks, and how one is carried out."""

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
from tuning_benchmark.campaign import provenance
from tuning_benchmark.campaign.calibration import calibrate
from tuning_benchmark.campaign.cost import cost_of_run
from tuning_benchmark.campaign.fields import surrogate_fields, true_fields
from tuning_benchmark.campaign.runs import RunSize, run_and_judge
from tuning_benchmark.experiments import task_names
from tuning_benchmark.experiments.experiment import Case, Cost, Experiment, Row
from tuning_benchmark.judging.neighbours import judge_neighbours
from tuning_benchmark.judging.truth import truth_of, verdict_record


@dataclass(frozen=True)
class Task:
    """One piece of a campaign.

    Attributes
    ----------
    name
        Unique in its campaign, such as ``run/benchmark/IV/3``.
    function, arguments
        Function to call, which returns what JSON takes.
    modules
        Modules with the code that it runs.
    version
        Digest of that code and of the arguments.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...]
    modules: tuple[str, ...]
    version: str


def tasks_of(experiment: Experiment) -> list[Task]:
    """List the tasks of an experiment, with the runs of one seed together."""
    tasks: list[Task] = []
    for case in experiment.cases.values():
        tasks += _runs(case, experiment.judge)
        tasks += _points(case, experiment.judge)
        tasks += _fields(case, experiment.judge)
    if experiment.calibration is not None:
        modules = _modules(experiment.calibration.study)
        tasks.append(_task(task_names.CALIBRATION, calibrate, (experiment.calibration,), modules))
    if experiment.cost is not None:
        tasks += _costs(experiment.cost)
    return tasks


def carry_out(task: Task) -> dict[str, Any]:
    """Do a task and return its record; what the task raises is put on record as its failure.

    Raises
    ------
    RunError
        If this process has other code or libraries than the one that asks.
    """
    try:
        version = _version(task.modules, task.name, task.arguments)
        for module in task.modules:
            importlib.import_module(module)
    except ImportError as error:
        raise RunError(
            f"{task.name}: {provenance.machine()} cannot import what it needs: {error}"
        ) from error
    if version != task.version:
        versions = ", ".join(provenance.versions(task.modules))
        raise RunError(
            f"{task.name}: {provenance.machine()} has another version of the code, or of {versions}"
        )
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
            "machine": provenance.machine(),
            "versions": ", ".join(provenance.versions(task.modules)),
            "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        },
    }


def judge_point(study: Study, judge: str, point: Mapping[str, Value]) -> dict[str, Any]:
    """Judge a parameter set, given by its tuned parameters, and its neighbours."""
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
            name = task_names.run_task(case.name, row.name, seed)
            tasks.append(_task(name, run_and_judge, arguments, modules))
    return tasks


def _points(case: Case, judge: str) -> list[Task]:
    modules = [*_modules(case.study), _module(judge)]
    tasks = []
    for name, point in case.points.items():
        arguments = (case.study, judge, dict(point.parameters))
        task = task_names.point_task(case.name, name)
        tasks.append(_task(task, judge_point, arguments, modules))
    return tasks


def _fields(case: Case, judge: str) -> list[Task]:
    figure = case.surrogates
    if figure is None:
        return []
    study = case.study
    modules = [*_modules(study), _module(judge)]
    row = dataclasses.replace(case.rows[figure.row], published={})
    arguments = (study, row, _size(case, row), figure)
    name = task_names.surrogates_task(case.name)
    tasks = [_task(name, surrogate_fields, arguments, modules)]
    for first in figure.axes(study)[0]:
        name = task_names.truth_task(case.name, first)
        tasks.append(_task(name, true_fields, (study, judge, figure, first), modules))
    return tasks


def _costs(cost: Cost) -> list[Task]:
    tasks = []
    for dimension in cost.dimensions:
        smallest = dimension == min(cost.dimensions)
        marks = sorted({cost.compared_trials, *(cost.trials if smallest else ())})
        for seed in range(1, cost.seeds + 1):
            arguments = (cost.algorithm, dimension, seed, marks)
            name = task_names.cost_task(dimension, seed)
            tasks.append(_task(name, cost_of_run, arguments, []))
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
    return provenance.digest(roots, name, repr(arguments))


def _modules(study: Study) -> list[str]:
    return [_module(node.object) for node in study.nodes.values() if node.object]


def _module(name: str) -> str:
    return name.partition(":")[0]
