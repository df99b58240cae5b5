"""``tune``: run a study, or resume a run, and report the result."""

import argparse
import contextlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bo_tuner.backends.ros.graph import describe_nodes
from bo_tuner.cli.check import check_study
from bo_tuner.cli.common import (
    RUNS,
    Parser,
    allow_programs,
    guarded,
    recorded_backend,
    run_folder,
    split_ros_arguments,
)
from bo_tuner.cli.init import FIRST_STUDY, write_first_study
from bo_tuner.cli.session import RunOptions, Session
from bo_tuner.errors import OutputError, RunRecordError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import Output
from bo_tuner.optimizers.algorithms import (
    ALGORITHMS,
    DEFAULT_ALGORITHM,
    default_algorithm,
    several_objectives_problem,
)
from bo_tuner.recording.retention import MEGABYTE, Policy, RecordOptions
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.storage.trust import trust
from bo_tuner.study import maxima
from bo_tuner.study.changes import comparable, summarized
from bo_tuner.study.parts import BACKENDS, ROS
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import Describe, load_study, shipped_studies
from bo_tuner.trials import Trial, count_evaluations
from bo_tuner.web.address import listen

DESCRIPTION = """\
Find robust, real-time capable, safe parameters by two-stage constrained
Bayesian optimization, and validate them on fresh draws.
"""

EPILOG = """\
exit codes:
  0    a feasible parameter set was found, and kept all limits in the validation
  1    the run had to stop (nodes lost or disturbed three times in a row, disk
       full); its record is kept
  2    bad input: study, option, folder or nodes
  3    the run is complete, but no feasible parameter set was found
  130  interrupted by Ctrl-C (143: by SIGTERM, the service ~/abort or the live
       page, 129: the terminal was closed, 141: nobody reads the output any
       more); the nodes are stopped, the record is kept, and --resume continues
       the run

examples:
  tune                                 the benchmark study on nodes of its own
  tune --study full --trials 80        four parameters
  tune --study my_axis.yaml --attach   your study, on nodes that are running
  tune --backend inprocess --seed 7    without ROS, repeatable bit for bit
  tune --init my_axis.yaml             write a first study for running nodes
  tune --check my_axis.yaml            try the study on nodes that are running
  tune --resume latest                 resume an interrupted run
  tune --resume latest --trials 60     continue a run to 60 trials in all
  tune --start known.yaml              try parameter sets that you know first
  tune --from latest --trials 60       begin with the trials of an earlier run
  tune --stop-early                    stop when further trials are not worth it
  tune --web                           the report, live, in a browser
  tune --web --web-control             the same, with buttons to pause and end
  tune --json-lines | jq .event        events for another program
  tune --ros-args -r __ns:=/x_axis     all nodes in a namespace
"""

STUDY = "benchmark"
LARGEST_PORT = 65535
FROM_THE_RECORD = ("study", "seed", "output", "backend", "algorithm", "start")
"""Options that a resumed run takes from its record."""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("tune", DESCRIPTION, EPILOG)
    parser.add_argument(
        "--study",
        metavar="NAME|FILE",
        help=f"shipped study ({', '.join(shipped_studies())}) or path of a study file "
        f"(default: {STUDY})",
    )
    parser.add_argument(
        "--trials",
        type=int,
        metavar="N",
        help="number of trials, in place of the study's budget of trials and evaluations",
    )
    parser.add_argument(
        "--evaluations",
        type=int,
        metavar="N",
        help="number of evaluations of all trials, in place of the study's budget",
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of everything random (default: the study's)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help=f"where run folders are created (default: {RUNS})",
    )
    parser.add_backend_arguments(BACKENDS[0])
    parser.add_argument(
        "--record",
        type=Policy,
        choices=tuple(Policy),
        metavar="{" + ",".join(Policy) + "}",
        help="bags of trials to keep, on ROS: all, none, or notable ones, which were the best so "
        "far, are the worst one, or failed (default: notable)",
    )
    parser.add_argument(
        "--record-limit",
        type=_megabytes,
        default=RecordOptions.limit,
        metavar="MB",
        help="total size of all bags; beyond it the oldest are deleted, but never the best one's "
        f"(default: {RecordOptions.limit // MEGABYTE})",
    )
    parser.add_argument(
        "--algorithm",
        choices=tuple(ALGORITHMS),
        help="; ".join(f"{name}: {method.title}" for name, method in ALGORITHMS.items())
        + f" (default: {DEFAULT_ALGORITHM})",
    )
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
        "it says otherwise): YAML files of values by name, or parameter files of nodes; what a "
        "file leaves out has its default",
    )
    parser.add_argument(
        "--from",
        type=Path,
        dest="earlier",
        metavar="RUN",
        help="begin with the trials of an earlier run of the same study, which stays as it is; "
        "with --trials N, N trials in all",
    )
    parser.add_argument(
        "--check",
        metavar="NAME|FILE",
        help="hold a study against the nodes that are running, name every mistake in parameters "
        "and signals, try two runs of the default, and say how long the study would take; nothing "
        "is recorded, and the nodes get back their values",
    )
    parser.add_argument(
        "--init",
        type=Path,
        nargs="?",
        const=FIRST_STUDY,
        metavar="FILE",
        help="look at the nodes that are running and write a first study for them, with comments, "
        f"to a new file (default: {FIRST_STUDY}); asks on a terminal what to take of them",
    )
    for option, what in (
        ("--nodes", "nodes to tune"),
        ("--parameters", "parameters to tune, such as gain or node:gain"),
        ("--signals", "signals to record, such as /topic or /topic:field"),
    ):
        parser.add_argument(
            option, nargs="+", metavar="NAME", help=f"with --init: {what}, instead of being asked"
        )
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
    parser.add_argument(
        "--stop-early",
        action="store_true",
        help="stop the tuning when the expected gain of the remaining trials is below the noise; "
        "the best candidates are checked and validated as usual",
    )
    parser.add_argument(
        "--web",
        type=_port,
        nargs="?",
        const=0,
        metavar="PORT",
        help="serve the report of the run in progress, read-only, on this machine only, at an "
        "address with a token that is printed (default port: any that is free); it lists and "
        "compares the other runs in the same folder, too",
    )
    parser.add_argument(
        "--web-control",
        action="store_true",
        help="with --web: the page may pause, continue and end the run",
    )
    parser.add_trust_argument("with --resume or --from: ")
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    if arguments.init is not None:
        if arguments.study is not None or arguments.check is not None:
            parser.error("--init writes a study, and takes none")
        return write_first_study(
            arguments.init,
            arguments.nodes,
            arguments.parameters,
            arguments.signals,
            ros_arguments,
            interruption,
        )
    for name in ("nodes", "parameters", "signals"):
        if getattr(arguments, name) is not None:
            parser.error(f"--{name} needs --init")
    if arguments.check is not None:
        return check_study(arguments.check, ros_arguments, interruption)
    # Nodes that run can say what the study leaves open.
    describe = (
        partial(describe_nodes, ros_arguments=ros_arguments, interrupted=interruption.check)
        if arguments.attach
        else None
    )
    carried: tuple[Trial, ...] = ()
    if arguments.resume is not None and arguments.earlier is not None:
        parser.error("--resume continues a run, --from begins a new one; leave one out")
    if arguments.resume is not None:
        given = [name for name in FROM_THE_RECORD if getattr(arguments, name) is not None]
        if given:
            parser.error(f"--resume takes --{given[0]} from the run's record; leave it out")
        record = read_run(run_folder(arguments.resume))
        allow_programs(record, trusted=arguments.trust, attach=arguments.attach)
        study, algorithm, backend = record.study, record.algorithm, recorded_backend(record)
        stop_early = arguments.stop_early or record.stop_early
        if arguments.trials is not None or arguments.evaluations is not None:
            _check_more(arguments, record, parser)
            # Who asks for more trials does not want the earlier advice to stop.
            study, stop_early = _changed(study, arguments), arguments.stop_early
    elif arguments.earlier is not None:
        record = read_run(run_folder(arguments.earlier))
        study, stop_early = _study(arguments, describe, record), arguments.stop_early
        if arguments.study is None:
            allow_programs(record, trusted=arguments.trust, attach=arguments.attach)
        algorithm, backend = record.algorithm, recorded_backend(record)
        _check_comparable(record, study, arguments, parser)
        carried = record.trials
    else:
        study, stop_early = _study(arguments, describe), arguments.stop_early
        # Where that cannot be noted down, the commands on this run will ask for --trust.
        with contextlib.suppress(OutputError):
            trust(study)
        algorithm = arguments.algorithm or default_algorithm(study)
        backend = arguments.backend or BACKENDS[0]
        if problem := several_objectives_problem(algorithm, study):
            parser.error(f"--algorithm: {problem}")
    if stop_early and len(study.objectives) > 1:
        parser.error("--stop-early: expected a study with one objective; leave it out")
    if arguments.attach and backend != ROS:
        parser.error("--attach needs --backend ros")
    if arguments.web_control and arguments.web is None:
        parser.error("--web-control needs --web")
    if arguments.record not in (None, Policy.NONE) and backend != ROS:
        parser.error("--record needs --backend ros: without nodes there are no messages")
    options = RunOptions(
        algorithm=algorithm,
        backend=backend,
        attach=arguments.attach,
        ros_arguments=ros_arguments,
        record=RecordOptions(arguments.record or Policy.NOTABLE, arguments.record_limit),
        output=arguments.output_mode,
        stop_early=stop_early,
        carried=carried,
        carried_from=str(record.path.resolve()) if carried else "",
        web=None if arguments.web is None else listen(arguments.web),
        web_control=arguments.web_control,
    )
    if arguments.resume is not None:
        folder = RunFolder(record.path.resolve())
    else:
        folder = RunFolder.create(arguments.output or RUNS, study)
    try:
        return Session(study, folder, options, interruption).run()
    except BaseException:
        folder.discard()
        raise


def _port(text: str) -> int:
    """Read the number of a port; 0 stands for any."""
    if not text.isdecimal() or int(text) > LARGEST_PORT:
        raise argparse.ArgumentTypeError(f"{text}: expected a port, 0 to {LARGEST_PORT}")
    return int(text)


def _check_more(arguments: argparse.Namespace, record: RunRecord, parser: Parser) -> None:
    """Refuse to continue a run to what it has already, or to what it was to have anyway."""
    trials, evaluations = record.study.budget.trials, record.study.budget.evaluations
    done = count_evaluations(record.trials)
    if evaluations is not None:
        # The run may have ended before its last trial.
        trials = len(record.trials)
    for name, given, had in (
        ("trials", arguments.trials, trials),
        ("evaluations", arguments.evaluations, max(done, evaluations or 0)),
    ):
        if given is not None and given <= had:
            parser.error(f"--{name}: expected more than the {had} of the run, found {given}")


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


def _study(
    arguments: argparse.Namespace, describe: Describe | None, earlier: RunRecord | None = None
) -> Study:
    """Return the study to run: the one named, or else that of the earlier run, or the default."""
    if arguments.study is not None or earlier is None:
        study = load_study(STUDY if arguments.study is None else arguments.study, describe)
    else:
        study = earlier.study
    return _changed(study, arguments)


def _check_comparable(
    record: RunRecord, study: Study, arguments: argparse.Namespace, parser: Parser
) -> None:
    """Refuse to begin with trials that are of another study, or were made in another way."""
    for name, found in (("backend", record.backend), ("algorithm", record.algorithm)):
        if getattr(arguments, name) not in (None, found):
            parser.error(f"--{name}: expected {found}, as in the run of --from; leave it out")
    if differences := comparable(record.study, study):
        raise RunRecordError(f"{record.path}: is a run of another study: {summarized(differences)}")
    if not record.trials:
        raise RunRecordError(f"{record.path}: has no whole trial to begin with")
    evaluations = count_evaluations(record.trials)
    if study.budget.is_spent(len(record.trials), evaluations):
        if study.budget.evaluations is not None and evaluations >= study.budget.evaluations:
            parser.error(
                f"--evaluations: expected more than the {evaluations} of --from, found "
                f"{study.budget.evaluations}"
            )
        parser.error(
            f"--trials: expected more than the {len(record.trials)} of --from, found "
            f"{study.budget.trials}"
        )


def _changed(study: Study, arguments: argparse.Namespace) -> Study:
    """Return the study with the options of the command line."""
    sets = [read_parameter_set(path, study) for path in arguments.start or ()]
    try:
        return study.replace(
            trials=arguments.trials,
            evaluations=arguments.evaluations,
            seed=arguments.seed,
            start=sets,
        )
    except StudyError as error:
        option = error.path[-1] if error.path else ""
        raise StudyError(f"--{option}: {error.problem}") from error
