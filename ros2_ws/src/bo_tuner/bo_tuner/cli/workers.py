"""How many evaluations of a run are run at once, by its options, its study and its record."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

from bo_tuner.backends.workers.limits import problem_of_workers
from bo_tuner.cli.common import Parser, whole_number
from bo_tuner.errors import StudyError
from bo_tuner.storage.provenance import recorded_window, recorded_workers
from bo_tuner.study import maxima
from bo_tuner.study.parts import ROS
from bo_tuner.study.study import Study
from bo_tuner.text import counted


@dataclass(frozen=True)
class Workers:
    """How many evaluations are run at once.

    Attributes
    ----------
    count
        Number of workers.
    window
        Number of trials, or other tasks, that are planned at once.
    """

    count: int = 1
    window: int = 1

    def text(self, backend: str) -> str:
        """Tell of several workers in a line; empty for one."""
        if self.count == 1:
            return ""
        bags = "; no bags are recorded" if backend == ROS else ""
        planned = counted(self.window, "task") + " planned at once"
        return f"{self.count} workers, {planned}{bags}"


def add_workers_arguments(parser: Parser, default: str) -> None:
    """Add the options for several workers; `default` is told in the help."""
    group = parser.add_argument_group("several runs at once")
    group.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help="evaluations that run at once, each on nodes of its own, which it starts in a ROS "
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


def workers_of(
    arguments: argparse.Namespace,
    parser: Parser,
    study: Study,
    backend: str,
    *,
    attach: bool,
    provenance: Mapping[str, str] | None = None,
    keeps_window: bool = True,
) -> Workers:
    """Return how many evaluations are to be run at once.

    Parameters
    ----------
    arguments, parser
        Of the command.
    study, backend, attach
        What is run, and where.
    provenance
        Of the run that goes on, or that the command is about; None for a new run.
    keeps_window
        Whether its window is to stay as it is: its trials were planned by it.

    Raises
    ------
    StudyError
        If the study cannot be run by so many.
    """
    for name in ("workers", "window"):
        given = getattr(arguments, name)
        if given is not None and not 1 <= given <= maxima.WORKERS:
            bound = "at least 1" if given < 1 else f"at most {maxima.WORKERS}"
            parser.error(f"--{name}: expected {bound}, found {given}")
    count = arguments.workers
    if count is None and provenance is not None:
        # Of one that ran on other nodes before, these may be running ones.
        count = 1 if attach else recorded_workers(provenance)
    count = count or study.budget.workers or 1
    if problem := problem_of_workers(study, backend, count, attach=attach):
        raise StudyError(f"--workers: {problem}")
    if provenance is None or not keeps_window:
        return Workers(count, arguments.window or count)
    window = recorded_window(provenance)
    if arguments.window not in (None, window):
        parser.error(
            f"--window: expected {window}, by which the trials of the run were planned, found "
            f"{arguments.window}; leave it out"
        )
    return Workers(count, window)
