"""Makes the backend that a command line or a record names."""

import os
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import in_namespace, namespace_of
from bo_tuner.backends.workers.answer import MakeBackend
from bo_tuner.backends.workers.clusters import RunningCluster
from bo_tuner.backends.workers.identity import needs_of
from bo_tuner.backends.workers.limits import times_of_nodes
from bo_tuner.backends.workers.pool import BREAKING_OFF, CLOSING, WorkerPool
from bo_tuner.backends.workers.workers import Bench, Workers
from bo_tuner.storage.atomic import writing
from bo_tuner.study.parts import IN_PROCESS, ROS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation

ALONE = Workers()
Listening = Callable[[RosBackend], Backend]
HOST_LOGS = "bo_tuner"
"""Folder, where the workers of a cluster may write, of what their nodes print."""


def make_backend(
    name: str,
    study: Study,
    log_directory: Path,
    *,
    attach: bool,
    run_log: Path | None = None,
    ros_arguments: Sequence[str],
    interrupted: Callable[[], None],
    earlier: Iterable[Evaluation] = (),
    halt: Callable[[str], None] | None = None,
    workers: Workers = ALONE,
    listening: Listening | None = None,
) -> Backend:
    """Make a backend, not open yet."""
    if workers.pooled:
        ros = tuple(ros_arguments)
        return _pool(name, study, log_directory, ros, interrupted, workers, listening)
    if name == IN_PROCESS:
        return InProcessBackend(study, interrupted)
    backend = RosBackend(
        study,
        log_directory,
        attach=attach,
        run_log=run_log,
        guard=attach or study.guard.always,
        halt=halt,
        ros_arguments=list(ros_arguments),
        interrupted=interrupted,
    )
    backend.recall(earlier)
    return backend


def _pool(
    name: str,
    study: Study,
    log_directory: Path,
    ros_arguments: tuple[str, ...],
    interrupted: Callable[[], None],
    workers: Workers,
    listening: Listening | None,
) -> WorkerPool:
    """Make the backend that has one of its own in each worker."""
    patience = BREAKING_OFF if name == IN_PROCESS else CLOSING
    cluster = None
    if workers.scheduler:
        timed = tuple(sorted(times_of_nodes(study))) if name == ROS else ()
        cluster = RunningCluster(workers.scheduler, workers.count, needs_of(study, name), timed)
    if name == IN_PROCESS:
        make: MakeBackend = partial(_in_process, study)
        return WorkerPool(name, workers.count, make, interrupted, patience, cluster)
    if workers.benches:
        on_nodes = partial(_on_bench, study, log_directory, ros_arguments, workers.benches)
    else:
        # Another host does not have the folder of the run.
        relative = Path(HOST_LOGS, log_directory.resolve().parent.name)
        own = relative if workers.scheduler else log_directory.resolve()
        on_nodes = partial(_on_own_nodes, study, own, ros_arguments)
    make = on_nodes if listening is None else partial(_heard, listening, on_nodes)
    return WorkerPool(name, workers.count, make, interrupted, patience, cluster)


def _in_process(
    study: Study, number: int, host_folder: Path, interrupted: Callable[[], None]
) -> Backend:
    """Make the backend of a worker: objects in its process."""
    del number, host_folder
    return InProcessBackend(study, interrupted)


def _heard(
    listening: Listening,
    make: Callable[[int, Path, Callable[[], None]], RosBackend],
    number: int,
    host_folder: Path,
    interrupted: Callable[[], None],
) -> Backend:
    """Make the backend of a worker, which hears its nodes."""
    return listening(make(number, host_folder, interrupted))


def _on_own_nodes(
    study: Study,
    log_directory: Path,
    ros_arguments: Sequence[str],
    number: int,
    host_folder: Path,
    interrupted: Callable[[], None],
) -> RosBackend:
    """Make the backend of a worker: nodes that it starts; a relative folder is of its host."""
    return RosBackend(
        study,
        _made(host_folder / log_directory / f"worker-{number}"),
        guard=study.guard.always,
        ros_arguments=list(ros_arguments),
        interrupted=interrupted,
        worker=number,
    )


def _on_bench(
    study: Study,
    log_directory: Path,
    ros_arguments: Sequence[str],
    benches: Sequence[Bench],
    number: int,
    host_folder: Path,
    interrupted: Callable[[], None],
) -> RosBackend:
    """Make the backend of a worker: running nodes that are its own."""
    del host_folder
    bench, arguments = benches[number - 1], list(ros_arguments)
    if bench.namespace != namespace_of(arguments):
        arguments = in_namespace(arguments, bench.namespace)
    os.environ["ROS_DOMAIN_ID"] = str(bench.domain)
    return RosBackend(
        study,
        _made(log_directory / f"worker-{number}"),
        attach=True,
        guard=True,
        ros_arguments=arguments,
        interrupted=interrupted,
        worker=number,
    )


def _made(folder: Path) -> Path:
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder
