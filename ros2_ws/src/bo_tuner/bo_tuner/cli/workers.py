"""By how many workers a run is run, and where: by its options, its study and its record."""

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace

from bo_tuner import maxima
from bo_tuner.backends.ros.isolation import LARGEST_DOMAIN, domain_of_environment, namespace_of
from bo_tuner.backends.ros.tuner_node import NAMESPACE
from bo_tuner.backends.workers.limits import problem_of_workers
from bo_tuner.backends.workers.workers import Bench, Workers
from bo_tuner.cli.common import Parser, asks_for_running_nodes, whole_number
from bo_tuner.errors import StudyError
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.study.study import Study

SCHEDULER_ADDRESS = re.compile(
    r"(tcp|tls)://[^\s/:]+:\d{1,5}|(tcp|tls)://\[[0-9a-fA-F:]+\]:\d{1,5}"
)


class _Benches(argparse.Action):
    """Takes the names of test benches, whose nodes run."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        """Set the option, and with it that the nodes run."""
        del parser, option_string
        namespace.benches = values
        namespace.attach = True


def add_workers_arguments(parser: Parser, default: str) -> None:
    """Add the options for several workers; `default` is told in the help."""
    group = parser.add_argument_group("several test runs at once")
    group.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help="test runs at a time, each on nodes of its own, which it starts in a ROS "
        f"domain of its own, or on objects in a process of its own (default: {default})",
    )
    group.add_argument(
        "--window",
        type=whole_number,
        metavar="Q",
        help="trials, or other tasks, that are planned at once; the answer depends on this number, "
        "and not on that of the workers or on which of them is faster (default: as many as "
        "workers, or as the run that is resumed)",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="use workers of the running Dask cluster with a scheduler at tcp://HOST:PORT, or "
        "tls://HOST:PORT; whoever reaches that can run programs on its workers",
    )
    group.add_argument(
        "--benches",
        action=_Benches,
        metavar="LIST",
        help="running nodes for several workers, as with --attach: ROS domains or namespaces of "
        "test benches that are alike, one a worker, such as 11,12,13 or /left,/right (default: as "
        "in the run, if there is one)",
    )


def workers_of(
    arguments: argparse.Namespace,
    parser: Parser,
    study: Study,
    backend: str,
    *,
    attach: bool,
    ros_arguments: Sequence[str],
    known: SessionOptions | None = None,
    keeps_window: bool = True,
) -> Workers:
    """Return by how many workers a run is to be run, and where."""
    for name in ("workers", "window"):
        given = getattr(arguments, name)
        if given is not None and not 1 <= given <= maxima.WORKERS:
            bound = "at least 1" if given < 1 else f"at most {maxima.WORKERS}"
            parser.error(f"--{name}: expected {bound}, found {given}")
    benches = _benches(arguments, parser, known, attach=attach, ros_arguments=ros_arguments)
    scheduler = _scheduler(arguments, parser, attach=attach)
    count = _count(arguments, parser, study, known, attach=attach, benches=benches)
    workers = Workers(count, arguments.window or count, scheduler, benches)
    if problem := problem_of_workers(study, backend, workers, attach=attach):
        raise StudyError(f"--workers: {problem}")
    if known is None or not keeps_window:
        return workers
    if arguments.window not in (None, known.window):
        parser.error(
            f"--window: expected {known.window}, by which the trials of the run were planned, "
            f"found {arguments.window}; leave it out"
        )
    return replace(workers, window=known.window)


def _count(
    arguments: argparse.Namespace,
    parser: Parser,
    study: Study,
    known: SessionOptions | None,
    *,
    attach: bool,
    benches: Sequence[Bench],
) -> int:
    """Return the number of workers: that given, that on record, or that of the study."""
    given: int | None = arguments.workers
    if benches:
        if given not in (None, len(benches)):
            parser.error(
                f"--workers: expected {len(benches)}, one for each of --benches, found {given}"
            )
        return len(benches)
    if given is not None:
        return given
    if known:
        # Those of a session on other nodes, or of a cluster, say nothing of what is here.
        elsewhere = known.scheduler and not arguments.scheduler
        return 1 if attach or elsewhere else known.workers
    if arguments.scheduler and study.budget.workers is None:
        parser.error("--scheduler: expected --workers N, too: how many test runs at once")
    return study.budget.workers or 1


def _scheduler(arguments: argparse.Namespace, parser: Parser, *, attach: bool) -> str:
    """Return the address of the cluster that is to be used; empty for none."""
    address: str | None = arguments.scheduler
    if address is None:
        return ""
    if not SCHEDULER_ADDRESS.fullmatch(address):
        found = address or "nothing"
        parser.error(f"--scheduler: expected tcp://HOST:PORT or tls://HOST:PORT, found {found}")
    if attach:
        given = asks_for_running_nodes(arguments)
        parser.error(
            "--scheduler: expected nodes that the workers start, found "
            f"{given or 'a run on running nodes'}; leave --scheduler out, or let "
            "the workers start them (--no-attach)"
        )
    return address


def _benches(
    arguments: argparse.Namespace,
    parser: Parser,
    known: SessionOptions | None,
    *,
    attach: bool,
    ros_arguments: Sequence[str],
) -> tuple[Bench, ...]:
    """Return the test benches that are given, or those on record; empty for none."""
    text: str | None = arguments.benches
    if text is not None and not attach:
        parser.error("--benches: expected nodes that run, found --no-attach")
    names: Sequence[str] = () if text is None else text.split(",")
    if text is None and known is not None and attach and arguments.workers is None:
        names = known.benches
    benches = [_bench(name, parser, ros_arguments) for name in names]
    for index, bench in enumerate(benches):
        if bench.place in {other.place for other in benches[:index]}:
            parser.error(f"--benches: expected each once, found {bench.name} again")
    if len(benches) > maxima.WORKERS:
        parser.error(f"--benches: expected at most {maxima.WORKERS}, found {len(benches)}")
    return tuple(benches)


def _bench(name: str, parser: Parser, ros_arguments: Sequence[str]) -> Bench:
    namespace = namespace_of(ros_arguments)
    if name.isascii() and name.isdigit() and int(name) <= LARGEST_DOMAIN:
        return Bench(name, int(name), namespace)
    if not NAMESPACE.fullmatch(name):
        parser.error(
            f"--benches: expected ROS domains from 0 to {LARGEST_DOMAIN}, or namespaces such as "
            f"/left, separated by commas, found {name!r}"
        )
    if namespace != "/":
        parser.error(
            f"--benches: expected namespaces in full, such as {namespace}{name}, and none in "
            "--ros-args"
        )
    # Without a domain in the environment, nodes that run already are in 0.
    return Bench(name, domain_of_environment() or 0, name.rstrip("/") or "/")
