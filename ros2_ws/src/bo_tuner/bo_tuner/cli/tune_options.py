"""The options of ``tune``."""

import argparse
from pathlib import Path

from bo_tuner.cli.common import RUNS, Parser, whole_number
from bo_tuner.cli.init import FIRST_STUDY
from bo_tuner.cli.workers import add_workers_arguments
from bo_tuner.methods.registry import DEFAULT_METHOD, METHODS
from bo_tuner.monitoring.display import Output
from bo_tuner.recording.retention import MEGABYTE, Policy, RecordOptions
from bo_tuner.study import maxima
from bo_tuner.study.parameter import Number
from bo_tuner.study.parts import BACKENDS
from bo_tuner.study.study_file import shipped_studies

DESCRIPTION = """\
Find robust, real-time capable, safe parameters by two-stage constrained
Bayesian optimization, and validate them on fresh draws.
"""

EPILOG = """\
exit codes:
  0    a feasible parameter set was found, and the validation does not refute
       it; with --check, both test runs were completed; with --init, the study
       is written
  1    the run had to stop (nodes lost or disturbed three times in a row, disk
       full), and its record is kept; or test runs of the validation were lost,
       so that the verdict is incomplete, and --resume completes it; or it is
       complete, but an attached node was not restored, or an action goal did
       not end
  2    bad input: study, option, folder or nodes
  3    the run is complete, but no feasible parameter set was found, or its
       certificate is a FAIL; with --check, a run of the default failed,
       nothing moved in it, or over their whole range no tuned parameter was
       seen to move a metric
  130  interrupted by Ctrl-C (143: by SIGTERM, the service ~/abort or the live
       page, 129: the terminal was closed, 141: the output pipe was closed);
       the nodes are stopped, the record is kept, and --resume continues the run

examples:
  tune                                 the benchmark study on nodes of its own
  tune --study full --trials 80        four parameters
  tune --study my_axis.yaml --attach   your study, on nodes that are running
  tune --backend inprocess --seed 7    without ROS, repeatable bit for bit
  tune --study my_axis.yaml --workers 4   four evaluations at once
  tune --init my_axis.yaml             write a first study for running nodes
  tune --check my_axis.yaml            try the study on its nodes
  tune --resume latest                 resume an interrupted run
  tune --resume latest --trials 60     continue a run to 60 trials in all
  tune --start known.yaml              try parameter sets that you know first
  tune --from latest --trials 60       begin with the trials of an earlier run
  tune --from latest --bounds kp=0.1:20   the same, with wider bounds
  tune --stop-early                    stop when further trials are not worth it
  tune --web                           the report, live, in a browser
  tune --web --web-control             the same, with buttons to pause and end
  tune --json-lines | jq .event        events for another program
  tune --ros-args -r __ns:=/x_axis     all nodes in a namespace
"""

STUDY = "benchmark"
LARGEST_PORT = 65535


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("tune", DESCRIPTION, EPILOG)
    _add_study(parser)
    parser.add_backend_arguments(BACKENDS[0])
    add_workers_arguments(parser, "the study's, else 1, or as the run that is resumed")
    _add_record(parser)
    parser.add_argument(
        "--algorithm",
        choices=tuple(METHODS),
        help="; ".join(f"{name}: {method.title}" for name, method in METHODS.items())
        + f" (default: {DEFAULT_METHOD})",
    )
    _add_known(parser)
    _add_running_nodes(parser)
    _add_output(parser)
    parser.add_argument(
        "--stop-early",
        action="store_true",
        help="stop the tuning when the expected gain of the remaining trials is below the noise; "
        "the best candidates are checked and validated as usual",
    )
    _add_web(parser)
    parser.add_trust_argument("with --resume or --from: ")
    return parser


def _add_study(parser: Parser) -> None:
    parser.add_argument(
        "--study",
        metavar="NAME|FILE",
        help=f"shipped study ({', '.join(shipped_studies())}) or path of a study file "
        f"(default: {STUDY})",
    )
    parser.add_argument(
        "--trials",
        type=whole_number,
        metavar="N",
        help="number of trials, in place of the study's budget of trials and evaluations; the "
        "initial design has at most as many",
    )
    parser.add_argument(
        "--evaluations",
        type=whole_number,
        metavar="N",
        help="number of evaluations of all trials, in place of the study's budget",
    )
    parser.add_argument(
        "--seed",
        type=whole_number,
        metavar="N",
        help="random seed of the run (default: the study's)",
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help=f"where run folders are created (default: {RUNS})",
    )


def _add_record(parser: Parser) -> None:
    parser.add_argument(
        "--record",
        choices=[policy.value for policy in Policy],
        help="bags of trials to keep, on ROS: all, none, or notable: a new best, the worst so far, "
        "or failed (default: notable, or as the run that is resumed)",
    )
    parser.add_argument(
        "--record-limit",
        type=_megabytes,
        metavar="MB",
        help="total size of all bags; beyond it the oldest are deleted, but never the best one's "
        f"(default: {RecordOptions.limit // MEGABYTE}, or as the run that is resumed)",
    )


def _add_known(parser: Parser) -> None:
    """Add the options that name what is known before: a run, or parameter sets."""
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="resume the interrupted run in this folder; recorded evaluations are not repeated; "
        "with --trials N or --evaluations N larger than before, the run continues to N",
    )
    parser.add_argument(
        "--start",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="parameter sets to try first, after those that the study names (the default unless "
        "it says otherwise): YAML files of values by name, or parameter files of nodes; values "
        "missing from the file take their defaults",
    )
    parser.add_argument(
        "--from",
        type=Path,
        dest="earlier",
        metavar="RUN",
        help="begin with the trials of an earlier run, which stays as it is, as far as they are "
        "data of the study: by default that of the run, with --study or --bounds one with other "
        "bounds, limits, metrics or objective; with --trials N, N trials in all (default: as many "
        "more as the run had, or with --study as that says)",
    )
    parser.add_argument(
        "--bounds",
        type=_bounds,
        action="append",
        metavar="NAME=LOWER:UPPER",
        help="other bounds of a tuned number than the study has, such as kp=0.1:20; once for each",
    )


def _add_running_nodes(parser: Parser) -> None:
    """Add the options for a study that is written, or tried, on running nodes."""
    parser.add_argument(
        "--check",
        metavar="NAME|FILE",
        help="check a study against its nodes, report every mistake in parameters, contexts, "
        "signals and steps of the run, make two test runs of the default, try what each tuned "
        "parameter moves (see --sensitivity), and estimate how long the study would take (also "
        "with --trials, --evaluations or --seed); nothing is recorded, and all values of the nodes "
        "are restored; nodes that are not running are started and ended if the study says how "
        "(--attach: never, --no-attach: always)",
    )
    parser.add_argument(
        "--sensitivity",
        action=argparse.BooleanOptionalAction,
        help="with --check: try the whole range of each tuned parameter, not only small steps from "
        "the default; or do not try them at all (default: the whole range on nodes that the check "
        "starts, small steps on nodes that run already)",
    )
    parser.add_argument(
        "--init",
        type=Path,
        nargs="?",
        const=FIRST_STUDY,
        metavar="FILE",
        help="look at the nodes that are running and write a first study for them, with comments, "
        f"to a new file (default: {FIRST_STUDY}); on a terminal, asks what to include",
    )
    for option, what in (
        ("--nodes", "nodes to tune"),
        ("--parameters", "parameters to tune, such as gain or node:gain"),
        (
            "--signals",
            "signals to record, such as /topic, /topic:field, /scan:ranges[0] or "
            "'/scan:min(ranges)'",
        ),
    ):
        parser.add_argument(
            option, nargs="+", metavar="NAME", help=f"with --init: {what}, instead of being asked"
        )


def _add_output(parser: Parser) -> None:
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument(
        "--quiet",
        dest="output_mode",
        action="store_const",
        const=Output.QUIET,
        default=Output.PROGRESS,
        help="show only the result and warnings",
    )
    shown.add_argument(
        "--json-lines",
        dest="output_mode",
        action="store_const",
        const=Output.JSON_LINES,
        help="write each event as one line of JSON to stdout, for other programs",
    )


def _add_web(parser: Parser) -> None:
    parser.add_argument(
        "--web",
        type=_port,
        nargs="?",
        const=0,
        metavar="PORT",
        help="serve the report of the run in progress, read-only, on this machine only, at an "
        "address with a token that is printed (default: any free port); it lists and "
        "compares the other runs in the same folder, too",
    )
    parser.add_argument(
        "--web-control",
        action="store_true",
        help="with --web: the page may pause, continue and end the run",
    )


def _bounds(text: str) -> tuple[str, tuple[Number, Number]]:
    """Read the name of a parameter, and its bounds."""
    name, _, pair = text.rpartition("=")
    lower, _, upper = pair.partition(":")
    try:
        if not name:
            raise ValueError
        return name, (_number(lower), _number(upper))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected NAME=LOWER:UPPER, such as kp=0.1:20"
        ) from None


def _number(text: str) -> Number:
    """Read a number; an integer parameter takes no 3.0."""
    try:
        return int(text)
    except ValueError:
        return float(text)


def _port(text: str) -> int:
    """Read the number of a port; 0 stands for any."""
    if not text.isdecimal() or int(text) > LARGEST_PORT:
        raise argparse.ArgumentTypeError(f"{text}: expected a port, 0 to {LARGEST_PORT}")
    return int(text)


def _megabytes(text: str) -> int:
    """Read a size [MB] as bytes."""
    try:
        size = float(text)
    except ValueError:
        size = float("nan")
    if not 0.0 < size <= maxima.MEGABYTES:
        raise argparse.ArgumentTypeError(
            f"{text}: expected a positive number of at most {maxima.MEGABYTES} megabytes"
        )
    return round(size * MEGABYTE)
