"""The options of ``tune``, and what is said of wrong ones: one line each, and exit code 2."""

import argparse
import sys
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import NoReturn

from threadpoolctl import threadpool_limits

from bo_tuner.errors import BackendError, OutputError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.methods import METHODS
from bo_tuner.recording.retention import MEGABYTE, Policy, RecordOptions
from bo_tuner.session import EXIT_USAGE, Session
from bo_tuner.study import Study
from bo_tuner.study_file import load_study, shipped_studies

DESCRIPTION = """\
Find robust, real-time capable, safe parameters by two-stage constrained
Bayesian optimization, and validate them on fresh draws.
"""

EPILOG = """\
exit codes:
  0    a feasible parametrization was found and held in the validation
  1    the run could not go on (nodes lost three times in a row, disk full);
       its record stays
  2    something given is wrong: study, option, folder, nodes
  3    the run is complete, but nothing feasible was found
  130  interrupted by Ctrl-C (143: by SIGTERM); nodes are down, the record stays

examples:
  tune                                 the benchmark study on nodes of its own
  tune --study full --trials 80        four parameters
  tune --study my_axis.yaml --attach   your study, on nodes that run already
  tune --backend inprocess --seed 7    without ROS, repeatable to the last bit
  tune --ros-args -r __ns:=/x_axis     all nodes in a namespace
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, without the usage."""
        self.exit(EXIT_USAGE, f"error: {message} (tune --help tells more)\n")


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    parser = _Parser(
        prog="tune",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--study",
        default="benchmark",
        metavar="NAME|FILE",
        help=f"shipped study ({', '.join(shipped_studies())}) or path of a study file "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--trials", type=int, metavar="N", help="number of parametrizations (default: the study's)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of everything random (default: the study's)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs"),
        metavar="DIR",
        help="where run folders are made (default: %(default)s)",
    )
    parser.add_argument(
        "--backend",
        choices=("ros", "inprocess"),
        default="ros",
        help="cuts on ROS nodes, or on the same objects in this process (default: %(default)s)",
    )
    parser.add_argument(
        "--attach", action="store_true", help="use nodes that run already instead of starting them"
    )
    parser.add_argument(
        "--record",
        type=Policy,
        choices=tuple(Policy),
        metavar="{" + ",".join(Policy) + "}",
        help="bags of trials to keep, on ROS: all, none, or notable ones, which were the best so "
        "far, are the worst, or failed (default: notable)",
    )
    parser.add_argument(
        "--record-limit",
        type=_megabytes,
        default=RecordOptions.limit,
        metavar="MB",
        help="size of all bags together; beyond it the oldest go, but never the best one's "
        f"(default: {RecordOptions.limit // MEGABYTE})",
    )
    parser.add_argument(
        "--algorithm",
        choices=tuple(METHODS),
        default="IV",
        help="; ".join(f"{name}: {method.title}" for name, method in METHODS.items())
        + " (default: %(default)s)",
    )
    return parser


def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command; returns its exit code, or exits after a wrong option.

    Parameters
    ----------
    argv
        The command line without the command; may hold ``--ros-args``.
    interruption
        Ends the run on a signal.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # A terminal that cannot show a sign of ours gets a question mark, not an error.
            stream.reconfigure(errors="replace")
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    if arguments.attach and arguments.backend != "ros":
        parser.error("--attach needs --backend ros")
    if arguments.record not in (None, Policy.NONE) and arguments.backend != "ros":
        parser.error("--record needs --backend ros: without nodes there are no messages")
    try:
        # More threads than one only slow down the small matrices of the surrogates.
        with threadpool_limits(1):
            session = Session(
                _study(arguments),
                arguments.algorithm,
                arguments.output,
                arguments.backend,
                interruption,
                attach=arguments.attach,
                ros_arguments=ros_arguments,
                record=RecordOptions(arguments.record or Policy.NOTABLE, arguments.record_limit),
            )
            return session.run()
    except (StudyError, OutputError, BackendError) as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        return EXIT_USAGE


def _megabytes(text: str) -> int:
    """Read a size [MB] as bytes."""
    try:
        size = float(text)
    except ValueError:
        size = float("nan")
    if not 0.0 < size < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: expected a positive number of megabytes")
    return round(size * MEGABYTE)


def split_ros_arguments(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Part the own arguments from those between ``--ros-args`` and ``--``, or the end."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for argument in argv:
        starts = argument == "--ros-args"
        ends = inside and argument == "--"
        (ros if inside or starts else own).append(argument)
        inside = starts or (inside and not ends)
    return own, ros


def _study(arguments: argparse.Namespace) -> Study:
    study = load_study(arguments.study)
    try:
        return study.replace(trials=arguments.trials, seed=arguments.seed)
    except StudyError as error:
        option = error.path[-1] if error.path else ""
        raise StudyError(f"--{option}: {error.problem}") from error
