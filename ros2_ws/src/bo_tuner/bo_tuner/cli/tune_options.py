"""The options of ``tune``."""

import argparse
from pathlib import Path

from bo_tuner import maxima
from bo_tuner.cli.common import RUNS, Group, Parser
from bo_tuner.cli.notify import add_notify_argument
from bo_tuner.cli.study_options import add_bounds_argument, add_budget_arguments
from bo_tuner.cli.time_limit import TimeLimit, time_limit
from bo_tuner.cli.web_options import add_control_argument, add_host_argument, port
from bo_tuner.cli.workers import add_workers_arguments
from bo_tuner.method_names import DEFAULT_METHOD, SAFE, titles
from bo_tuner.monitoring.display import Output
from bo_tuner.recording.retention import MEGABYTE, Policy, RecordOptions
from bo_tuner.study.parts import BACKENDS
from bo_tuner.study.study_file import shipped_studies

DESCRIPTION = """\
Find robust, real-time capable, safe parameters by two-stage constrained
Bayesian optimization, and validate them in fresh runs. For a study of your own
nodes, `init` writes a first one, and `check` tries it.
"""

EPILOG = """\
exit codes:
  0    a feasible parameter set was found, and the validation does not refute
       it
  1    the run had to stop (nodes lost or disturbed three times in a row, their
       guard ended, disk full), and its record is kept; or test runs of the
       validation were lost, so that the verdict is incomplete, and --resume
       completes it; or the --time is over before the certificate of --certify
       has a verdict, and `validate` goes on with it; or the run is complete,
       but an attached node was not restored, or an action goal did not end
  2    bad input: study, option, folder or nodes
  3    the run is complete, but no feasible parameter set was found, or its
       certificate is a FAIL
  130  interrupted by Ctrl-C (143: by SIGTERM, the service ~/abort or the live
       page, 129: the terminal was closed, 141: the output pipe was closed);
       the nodes are stopped, the record is kept, and --resume continues the run

examples:
  tune                                 the benchmark study on nodes of its own
  tune --study full --trials 80        four parameters
  tune --study my_axis.yaml --attach   your study, on nodes that are running
  tune --backend inprocess --seed 7    without ROS, repeatable bit for bit
  tune --study my_axis.yaml --workers 4   four test runs at once
  tune --study my_axis.yaml --benches 11,12   on two sets of running nodes
  tune --resume latest                 resume an interrupted run
  tune --resume latest --trials 60     continue a run to 60 trials in all
  tune --start known.yaml              try parameter sets that you know first
  tune --from latest --trials 60       begin with the trials of an earlier run
  tune --from latest --bounds kp=0.1:20   the same, with wider bounds
  tune --study my_axis.yaml --from latest --simulated   knowing a simulation
  tune --time 30min                    have the result by then
  tune --time 30min --certify          and its certificate
  tune --study my_axis.yaml --attach --confirm   a safe search that asks first
  tune --stop-early                    stop when further trials are not worth it
  tune --web                           the report, live, in a browser
  tune --web --web-control             the same, with buttons to pause and end
  tune --notify 'notify-send "$BO_TUNER_HEADLINE"'   a message at the end
  tune --json-lines | jq .event        events for another program
  tune --ros-args -r __ns:=/x_axis     all nodes in a namespace
"""

STUDY = "benchmark"


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("tune", DESCRIPTION, EPILOG)
    _add_study(parser.add_argument_group("study"))
    _add_known(parser.add_argument_group("what is known before"))
    _add_method(parser.add_argument_group("method"))
    parser.add_backend_arguments(BACKENDS[0], "with --resume or --from: ")
    add_workers_arguments(parser, "the study's, else 1, or as the run that is resumed")
    _add_record(parser.add_argument_group("files"))
    _add_output(parser.add_argument_group("output"))
    _add_web(parser.add_argument_group("live page"))
    return parser


def _add_study(group: Group) -> None:
    group.add_argument(
        "--study",
        metavar="NAME|FILE",
        help=f"shipped study ({', '.join(shipped_studies())}) or path of a study file "
        f"(default: {STUDY})",
    )
    add_budget_arguments(group)
    group.add_argument(
        "--time",
        type=time_limit,
        default=TimeLimit(),
        metavar="TIME",
        help="have the result, validated, after this time, such as 90s, 30min or 2h: no trial is "
        "begun that would be too late, and the best so far is settled and validated; the budget "
        "of the study stays the most",
    )
    group.add_argument(
        "--certify",
        action="store_true",
        help="certify the result at the end, as validate does; with --time that is in the time, of "
        "which up to half is kept for it",
    )
    add_bounds_argument(group)


def _add_known(group: Group) -> None:
    """Add the options that name what is known before: a run, or parameter sets."""
    group.add_argument(
        "--resume",
        type=Path,
        metavar="RUN",
        help="resume the interrupted run in this folder; recorded test runs are not repeated; "
        "with --trials N or --evaluations N larger than before, the run continues to N",
    )
    group.add_argument(
        "--from",
        type=Path,
        dest="earlier",
        metavar="RUN",
        help="begin with the trials of an earlier run, which stays as it is, as far as they are "
        "data of the study: by default that of the run, with --study or --bounds one with other "
        "bounds, limits, metrics or objective; with --trials N, N trials in all (default: as many "
        "more as the run had, or with --study as that says)",
    )
    group.add_argument(
        "--simulated",
        action="store_true",
        help="the run of --from is one of a simulation: its trials are prior knowledge of the "
        "machine of --study, with a bias that is modelled and shown; they are no trials of the "
        "new run, which begins with its own start and the result of the simulation",
    )
    group.add_argument(
        "--start",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="parameter sets to try first, after those that the study names (the default unless "
        "it says otherwise): YAML files of values by name, or parameter files of nodes; values "
        "missing from the file take their defaults",
    )


def _add_method(group: Group) -> None:
    offered = {name: title for name, title in titles().items() if name != SAFE}
    group.add_argument(
        "--algorithm",
        choices=tuple(offered),
        help="; ".join(f"{name}: {title}" for name, title in offered.items())
        + f" (default: {DEFAULT_METHOD}; a study with safe_search has one of its own)",
    )
    group.add_argument(
        "--confirm",
        action="store_true",
        help="with a safe search: show each parameter set before it is tried, and wait until you "
        "allow it, refuse it or end the trials, on the terminal, by a service, or on the live page "
        "(--web-control)",
    )
    group.add_argument(
        "--stop-early",
        action="store_true",
        help="stop the tuning when the expected gain of the remaining trials is below the noise; "
        "the best candidates are checked and validated as usual",
    )


def _add_record(group: Group) -> None:
    group.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help=f"where run folders are created (default: {RUNS})",
    )
    group.add_argument(
        "--record",
        choices=[policy.value for policy in Policy],
        help="bags of trials to keep, on ROS: all, none, or notable: a new best, the worst so far, "
        "or failed (default: notable, or as the run that is resumed)",
    )
    group.add_argument(
        "--record-limit",
        type=_megabytes,
        metavar="MB",
        help="total size of all bags; beyond it the oldest are deleted, but never the best one's "
        f"(default: {RecordOptions.limit // MEGABYTE}, or as the run that is resumed)",
    )


def _add_output(group: Group) -> None:
    shown = group.add_mutually_exclusive_group()
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
    add_notify_argument(group)


def _add_web(group: Group) -> None:
    group.add_argument(
        "--web",
        type=port,
        nargs="?",
        const=0,
        metavar="PORT",
        help="serve the report of the run in progress, read-only, on this machine only, at an "
        "address with a token that is printed (default: any free port); it lists and "
        "compares the other runs in the same folder, too (report --serve does without a run)",
    )
    add_control_argument(group, "--web", "pause, continue and end the run, and answer --confirm")
    add_host_argument(group, "--web")


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
