"""``try``: run a parameter set once, and show its metrics and its response."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import named_namespace
from bo_tuner.cli.common import RUNS, Parser, ended, guarded, opened, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.cli.study_on_nodes import is_running
from bo_tuner.cli.study_options import add_attach_argument, read_study, trust_given
from bo_tuner.codec import checks
from bo_tuner.errors import BackendError, ParameterError, StudyError
from bo_tuner.evidence.single_run import SingleRun
from bo_tuner.figures.figure import Panel
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.report.page import write_figure, write_single_run
from bo_tuner.report.sections.trajectories import NoTraceError, TracingBackend, simulate
from bo_tuner.report.single_run import (
    recorded_response,
    response_figure,
    single_run_sections,
    traced_response,
)
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study import strict_yaml
from bo_tuner.study.parts import BACKENDS, IN_PROCESS, ROS
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.text import values
from bo_tuner.trials import Context, Evaluation, Stage, Value
from bo_tuner.tuning.driver import Driver

DESCRIPTION = """\
Run one parameter set of a study once, in the nominal context or in another one,
and show its metrics beside the limits, and its response over time: a page and a
picture in a folder. One run proves nothing of the limits; `validate` does.
"""

EPILOG = """\
exit codes:
  0    the run is complete, and beyond no limit
  1    the run was lost with its nodes or disturbed, or an attached node was not
       restored
  2    bad input: study, values, context, option, folder or nodes
  3    the run failed, or is beyond a limit
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed); all values of the nodes are restored

examples:
  try my_study.yaml                                the default, on the nodes
  try my_study.yaml --parameters my_params.yaml    other values
  try my_study.yaml --set kp=2.5                   the default but for one value
  try my_study.yaml --context load=2 --context wind=3.5
  try my_study.yaml --no-attach                    on nodes that it starts
  try benchmark --backend inprocess                without ROS
"""

PAGE = "response.html"
BY_OBJECTS = "Simulated in process by the study's objects."
RECEIVED = "As received by the tuner; each value holds until the next message."


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("try", DESCRIPTION, EPILOG)
    parser.add_argument("study", metavar="STUDY", help="study file, or name of a shipped study")
    what = parser.add_argument_group("what to run")
    what.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="values by name, or a parameter file of nodes; values missing from it take their "
        "defaults (default: all defaults)",
    )
    what.add_argument(
        "--set",
        type=_named_value,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a parameter, once for each, also in place of that of the file",
    )
    what.add_argument(
        "--context",
        type=_named_value,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a context variable, once for each (default: the nominal one)",
    )
    parser.add_argument_group("files").add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help=f"folder of the page and the picture (default: {RUNS}/STUDY-try)",
    )
    nodes = parser.add_argument_group("nodes")
    nodes.add_argument(
        "--backend",
        choices=BACKENDS,
        default=BACKENDS[0],
        help="run on ROS nodes, or on the same objects in this process (default: %(default)s)",
    )
    add_attach_argument(nodes)
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    name: str = arguments.backend
    attach: bool | None = arguments.attach
    if attach and name != ROS:
        parser.error("--attach needs --backend ros")
    ask_nodes = name == ROS and attach is not False
    study = read_study(arguments.study, ask_nodes, ros_arguments, interruption)
    if attach is None:
        attach = name == ROS and is_running(study, ros_arguments, interruption)
    given = _parameters(study, arguments.parameters, arguments.set, ros_arguments)
    planned = _planned(study, given, _context(study, arguments.context))
    trust_given(study)
    path = arguments.output or RUNS / f"{study.name}-try"
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
    folder = RunFolder(path)
    try:
        with writing(folder.log):
            folder.log.mkdir(exist_ok=True)
        backend: Backend
        if name == IN_PROCESS:
            backend = TracingBackend(study, interruption.check)
        else:
            backend = make_backend(
                name,
                study,
                folder.log,
                attach=attach,
                ros_arguments=ros_arguments,
                interrupted=interruption.check,
            )
        with opened(backend, interruption) as left:
            result = SingleRun(study, Driver(backend).evaluate(planned))
            drawn, missing = _response(backend, result)
        _show(result)
        _write(result, drawn, missing, path)
    finally:
        folder.close()
    return ended(left, _exit_code(result))


def _exit_code(result: SingleRun) -> int:
    if result.within:
        return EXIT_OK
    return EXIT_FAULT if result.evaluation.outcome.unusable else EXIT_INFEASIBLE


def _planned(study: Study, parameters: Mapping[str, Value], context: Context) -> Evaluation:
    """Return the run, with the noise of the first evaluation of the study's first trial."""
    seed = noise_seed(study.seed, Stream.NOISE, 0, 0)
    return Evaluation(0, 0, Stage.NOMINAL, parameters, context, seed)


def _parameters(
    study: Study,
    file: Path | None,
    given: Sequence[tuple[str, Value]],
    ros_arguments: Sequence[str],
) -> Mapping[str, Value]:
    """Return all parameters: those that are given, else those of a file, else the defaults."""
    of_file: Mapping[str, Value] = {}
    if file is not None:
        of_file = read_parameter_set(file, study, named_namespace(ros_arguments))
    try:
        by_name = _once_each(given)
        for name in by_name:
            checks.reference(name, "parameter", study.parameters)
        return study.complete_set({**of_file, **by_name})
    except StudyError as error:
        raise StudyError(f"--set: {error}") from None


def _once_each(given: Sequence[tuple[str, Value]]) -> dict[str, Value]:
    by_name = dict(given)
    if len(by_name) < len(given):
        twice = next(name for name, _ in given if [n for n, _ in given].count(name) > 1)
        raise StudyError(f"{twice} has more than one value; leave all but one out")
    return by_name


def _context(study: Study, given: Sequence[tuple[str, Value]]) -> Context:
    try:
        return study.context_space().completed(_once_each(given))
    except (ParameterError, StudyError) as error:
        raise StudyError(f"--context: {error}") from None


def _response(backend: Backend, result: SingleRun) -> tuple[list[Panel], str]:
    """Return the panels of the response, and where they are from; or none, and why."""
    study = result.study
    try:
        if isinstance(backend, TracingBackend):
            if not result.evaluation.outcome.complete:
                return [], "No signals: the run is not complete."
            return traced_response(study, backend.trace()), BY_OBJECTS
        if isinstance(backend, RosBackend) and study.signals:
            drawn = recorded_response(study, backend.recording)
            return drawn, RECEIVED if drawn else "No signals: none was received."
        (trace,) = simulate(study, [result.evaluation])
        return traced_response(study, trace), BY_OBJECTS
    except (NoTraceError, StudyError, BackendError) as error:
        return [], f"No signals: {error}."


def _show(result: SingleRun) -> None:
    """Print the metrics of the run beside their limits."""
    evaluation = result.evaluation
    context = values(evaluation.context)
    say(f"parameters: {values(result.study.search_space().active(evaluation.parameters))}")
    if context:
        say(f"context: {context}")
    table = Table()
    for column in ("metric", "unit"):
        table.add_column(column)
    for column in ("value", "limit"):
        table.add_column(column, justify="right")
    table.add_column("")
    for row in result.rows():
        table.add_row(row.metric, row.unit, row.value, row.limit, row.standing)
    if table.row_count:
        print_table(plain_console(), table)
    if remark := evaluation.outcome.notes.remark:
        say(f"note: {remark}")
    say(result.headline)


def _write(result: SingleRun, drawn: Sequence[Panel], remark: str, folder: Path) -> None:
    """Write the page, and the picture of the response if there is one."""
    figure = response_figure(result, drawn, remark) if drawn else None
    sections = single_run_sections(result, figure, "" if drawn else remark)
    page = write_single_run(f"{result.study.name}: one run", sections, folder / PAGE)
    if figure is None:
        say(remark)
    else:
        (picture,) = write_figure(figure, folder, ("png",))
        say(f"response: {picture}")
    say(f"page: {page}")


def _named_value(text: str) -> tuple[str, Value]:
    """Read the name of a parameter or a context variable, and its value."""
    name, _, value = text.partition("=")
    try:
        parsed = strict_yaml.parse(value).value
    except StudyError:
        parsed = None
    if isinstance(parsed, list):
        # Of a parameter that is a list, as trials have it.
        parsed = value
    if not name or not isinstance(parsed, (bool, int, float, str)):
        raise argparse.ArgumentTypeError(f"{text}: expected NAME=VALUE, such as load=1.5")
    return name, parsed
