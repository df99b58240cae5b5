"""How many workers a study can have, on this machine and by what it measures."""

import os
import re
import shlex
from collections.abc import Iterator

from bo_tuner.backends.workers.workers import Workers
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.nodes import WORKER, NodeSpec
from bo_tuner.study.parts import ROS
from bo_tuner.study.study import Study

GAP = "largest_gap"
LOWEST_PORT, HIGHEST_PORT = 1024, 65535
PORT = re.compile(r"(?:^|[:=@])(\d{4,5})$")
"""A number that ends a word of a command, such as ``--port 5760`` or ``udp:127.0.0.1:14550``."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def problem_of_workers(study: Study, backend: str, workers: Workers, *, attach: bool) -> str:
    """Return why a study cannot be run by some workers, in a line; empty if it can."""
    count = workers.count
    if attach and count > len(workers.benches or (1,)):
        return (
            f"expected 1 with --attach, found {count}: running nodes are one set, which runs one "
            "test run at a time; name several sets (--benches), or let each worker start nodes "
            "of its own (--no-attach)"
        )
    if count == 1 or backend != ROS:
        return ""
    timed = () if workers.scheduler else sorted(times_of_nodes(study))
    if timed and count > (most := cores()):
        return (
            f"expected at most {most}, the number of cores, found {count}: other workers make "
            f"measured times longer ({', '.join(timed)})"
        )
    if attach:
        return ""
    return next(
        (
            f"nodes.{key}: port {port} would be the same for all {count} workers; write "
            f"{WORKER} into it, which is the number of the worker, such as {port[:-1]}{WORKER}"
            for key, node in study.nodes.items()
            for port in ports(node)
        ),
        "",
    )


def times_of_nodes(study: Study) -> Iterator[str]:
    """Yield the names of metrics that are measured times, or gaps between messages in such."""
    for name, metric in study.metrics.items():
        if metric.measures_time or (isinstance(metric, SignalMetric) and metric.measure == GAP):
            yield name


def ports(node: NodeSpec) -> Iterator[str]:
    """Yield the numbers in what starts a node that look like ports and name no worker."""
    words = shlex.split(node.command or node.launch or "")
    for index, word in enumerate(words):
        named = index > 0 and "port" in words[index - 1].lower()
        if (number := _port(word, named=named or "port" in word.lower())) is not None:
            yield number
    for name, value in node.env.items():
        if (number := _port(value, named="port" in name.lower())) is not None:
            yield number


def _port(word: str, *, named: bool) -> str | None:
    """Return the port that a word ends with: after an address, or where its name says so."""
    match = PORT.search(word)
    if match is None or not LOWEST_PORT <= int(match[1]) <= HIGHEST_PORT:
        return None
    is_address = word[: match.start()] != "" and word[match.start()] in ":@"
    return match[1] if named or is_address else None
