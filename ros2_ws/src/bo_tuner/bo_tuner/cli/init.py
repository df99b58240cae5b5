"""``init``: write a first study for the nodes that are running."""

import contextlib
import shlex
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.graph import opened_node
from bo_tuner.backends.ros.play.bag import Bag
from bo_tuner.backends.ros.play.hearing import SECONDS, hear
from bo_tuner.backends.ros.processes import NodeProcess
from bo_tuner.backends.ros.started_nodes import found_program
from bo_tuner.backends.ros.survey import survey
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.cli.answers import show_answers
from bo_tuner.cli.chooser import Chooser
from bo_tuner.cli.common import Parser, guarded, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_OK
from bo_tuner.codec import checks
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.methods.registry import METHODS, method_of
from bo_tuner.monitoring.display import say
from bo_tuner.storage.atomic import writing
from bo_tuner.study.first_estimator import HeardBag, first_estimator, task_of
from bo_tuner.study.first_study import first_study
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.offers import (
    ParameterOffer,
    parameter_offers,
    suggested_nodes,
    suggested_parameters,
)
from bo_tuner.study.parameter_kinds import Kind
from bo_tuner.study.playing import Play, is_bag
from bo_tuner.study.roles import is_commanded, is_plant
from bo_tuner.study.seen import Seen, SeenNode
from bo_tuner.study.signal_offers import SignalOffer, signal_offers, suggested_signals
from bo_tuner.study.study_file import parse_study
from bo_tuner.text import counted, listed, shown

DESCRIPTION = """\
Look at the nodes that are running, and write a first study for them, with
comments, to a new file. On a terminal it asks what to include; else it takes
what it suggests, or what the options name.

With bags of drives it plays the beginning of the first one to the nodes, and
writes a study for the estimator that hears it; what is the truth, it tells by
names and types, unless --signals names it.
"""

EPILOG = """\
Nothing is set on the nodes. Lines with a CHECK in the study are guesses: settle
them, then try the study with `check`.

exit codes:
  0    the study is written
  1    the disk is full
  2    bad input: the file is there already, or something that is named is not
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed); nothing is written

examples:
  init my_study.yaml
  init my_study.yaml --parameters kp ki --signals /setpoint /joint_states
  init my_study.yaml --ros-args -r __ns:=/x_axis     nodes in a namespace
  init my_study.yaml drives/* --command 'python3 ekf_node.py'   tune on bags
"""

FIRST_STUDY = Path("study.yaml")
SUFFIXES = (".yaml", ".yml")
OPTIONS = {
    "--nodes": "nodes to tune",
    "--parameters": "parameters to tune, such as gain or node:gain",
    "--signals": "signals to record, such as /topic, /topic:field, /scan:ranges[0] or "
    "'/scan:min(ranges)'",
}


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("init", DESCRIPTION, EPILOG)
    parser.add_argument(
        "names",
        type=Path,
        nargs="*",
        metavar="FILE | BAG",
        help=f"the study file to write (default: {FIRST_STUDY}), and bags of drives, of which the "
        "first one is played to the nodes",
    )
    for option, what in OPTIONS.items():
        parser.add_argument(
            option, nargs="+", metavar="NAME", help=f"{what}, instead of being asked"
        )
    parser.add_argument(
        "--command",
        default="",
        help="with bags: starts the node, in the folder of FILE, for each run anew",
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    files = [path for path in arguments.names if path.suffix in SUFFIXES]
    bags = [path for path in arguments.names if path not in files]
    if len(files) > 1:
        parser.error(f"one study file is written, found {' and '.join(map(str, files))}")
    for path in bags:
        if not is_bag(path):
            parser.error(f"expected a file name that ends in .yaml, or a bag, found {path}")
    if arguments.command and not bags:
        parser.error("--command: name the bags that the node is to hear")
    path = files[0] if files else FIRST_STUDY
    _check_path(path)
    named = (arguments.nodes, arguments.parameters, arguments.signals)
    if bags:
        return write_estimator_study(
            path, bags, arguments.command, *named, ros_arguments, interruption
        )
    return write_first_study(path, *named, ros_arguments, interruption)


def write_first_study(
    path: Path,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Write a first study for what runs; returns the exit code."""
    with opened_node(ros_arguments, interruption.check) as tuner:
        seen, notes = survey(
            tuner, lambda seen: _has(seen, nodes, parameters, signals), signals or ()
        )
    for note in notes:
        say(f"note: {note}")
    if not seen.nodes:
        raise BackendError("no node is left whose parameters can be had")
    say(f"nodes found: {', '.join(node.name for node in seen.nodes)}")
    for names in seen.together:
        say(f"in one process, where one start brings up all: {', '.join(names)}")
    if not seen.topics:
        raise BackendError("no topic has a number that could be a signal while the nodes are idle")
    tuned, chosen, recorded = _choose(seen, nodes, parameters, signals, Chooser(interruption))
    text = first_study(str(path), seen, tuned, chosen, recorded, ros_arguments)
    _write(path, text, ros_arguments)
    return EXIT_OK


def write_estimator_study(
    path: Path,
    bags: Sequence[Path],
    command: str,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Write a first study for an estimator that hears bags; returns the exit code."""
    _check_drives(bags)
    folder = path.absolute().parent
    with opened_node(ros_arguments, interruption.check) as tuner:
        before = {*others.nodes(tuner.node)}
        with _started(tuner, command, folder):
            seen, notes = survey(tuner, lambda seen: _has(seen, nodes, parameters, None))
            heard = hear(tuner, Play(bag=str(bags[0].absolute())), folder, seen.nodes)
    for note in notes:
        say(f"note: {note}")
    hearing = dict.fromkeys(name for topic in heard.heard for name in topic.listeners)
    given = hearing if nodes is None else [name.lstrip("/") for name in nodes]
    started = [name for name in hearing if command and name not in before and name in given]
    if len(started) > 1:
        raise StudyError(f"--command starts {listed(started)}; choose one by --nodes")
    estimators = tuple(
        replace(node, is_estimator=True, command=command if node.name in started else "")
        for node in seen.nodes
        if node.name in hearing
    )
    _show_heard(heard, list(hearing))
    for name in signals or ():
        topics = [topic.name for topic in (*heard.topics, *heard.outputs)]
        if name not in topics:
            near = checks.suggestion(name, topics)
            raise StudyError(f"--signals: there is no topic {checks.quoted(name)}; {near}")
    task = task_of(heard, signals or ())
    if task is None:
        raise BackendError(f"{listed(list(hearing))} publishes no number that could be an estimate")
    truth = f"{task.truth.name} ({task.known_by})" if task.truth else "none found"
    say(f"estimate: {task.estimate.name}; truth: {truth}")
    chooser = Chooser(interruption)
    tuned, chosen = _choose_parameters(Seen(estimators, ()), nodes, parameters, chooser)
    names = [_seen_from(bag, folder) for bag in bags]
    text = first_estimator(str(path), names, heard, task, tuned, chosen, ros_arguments)
    _write(path, text, ros_arguments)
    return EXIT_OK


def _check_drives(bags: Sequence[Path]) -> None:
    """Refuse bags that cannot be read, and two of one drive."""
    read: list[Bag] = []
    for path in bags:
        bag = Bag(path)
        if other := next((o for o in read if bag.overlaps(o) or bag.path == o.path), None):
            raise StudyError(f"{path} is of the same drive as {other.path}; expected one bag of it")
        read.append(bag)


@contextlib.contextmanager
def _started(tuner: TunerNode, command: str, folder: Path) -> Iterator[None]:
    """Start a node, if there is a command for it, and end it afterwards."""
    if not command:
        yield
        return
    try:
        words = found_program(shlex.split(command), str(folder))
    except ValueError as error:
        problem = error.problem if isinstance(error, StudyError) else f"expected words: {error}"
        raise StudyError(f"--command: {problem}") from None
    before = {*others.nodes(tuner.node)}
    with tempfile.TemporaryDirectory(prefix="bo_tuner-init-") as logs:
        log = Path(logs, "node.log")
        process = NodeProcess(words[0], words, {"ROS_LOG_DIR": logs}, log, str(folder))

        def is_there() -> bool:
            return process.exit_reason is not None or bool({*others.nodes(tuner.node)} - before)

        try:
            found = tuner.wait_until(is_there, NodeSpec.start_timeout)
            if not found:
                limit = NodeSpec.start_timeout
                raise BackendError(f"--command: no node has come up within {limit:g} s")
            if process.exit_reason is not None:
                raise BackendError("has ended")
            yield
        except BackendError as error:
            # What has become of the others follows from that.
            reason = process.exit_reason
            raise error if reason is None else BackendError(f"--command: {reason}") from None
        finally:
            process.stop()


def _show_heard(heard: HeardBag, nodes: Sequence[str]) -> None:
    say(f"{listed(nodes)} heard {listed([topic.name for topic in heard.heard])}")
    show_answers(heard.answers)
    for topic in heard.outputs:
        if topic.is_silent:
            say(f"note: nothing came on {topic.name} in the first {SECONDS:g} s of the bag")


def _seen_from(bag: Path, folder: Path) -> str:
    """Return a bag as a study in a folder names it: in full, unless it lies there."""
    path = bag.absolute()
    return str(path.relative_to(folder) if path.is_relative_to(folder) else path)


def _write(path: Path, text: str, ros_arguments: Sequence[str]) -> None:
    """Write a study, and say what is in it and what comes next."""
    # Nothing is written that `tune --study` would refuse.
    study = parse_study(text, str(path))
    with writing(path):
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            _check_path(path)
    parameters = sum(parameter.is_tuned for parameter in study.parameters.values())
    contents = f"{counted(parameters, 'parameter')} and {counted(len(study.signals), 'signal')}"
    runs = METHODS[method_of(study)].most_evaluations(study)
    say(f"{path}: {contents}; {counted(study.budget.trials, 'trial')}, at most {runs} test runs")
    say("with the limits and contexts that are in comments it takes more; now review it and")
    say("resolve each CHECK in it: bounds, what a run does, what good means; then")
    say(f"  {shlex.join(['check', str(path), *ros_arguments])}")


def _has(
    seen: Seen,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
) -> bool:
    """Whether everything that is named is there."""
    names = {node.name for node in seen.nodes}
    known = {n for topic in seen.topics for o in signal_offers(topic) for n in _signal_names(o)}
    of_nodes: set[str] = set()
    for node in seen.nodes:
        offers, left = parameter_offers(node)
        for name in (*(offer.name for offer in offers), *left):
            of_nodes.update(_parameter_names(node.name, name))
    return (
        names.issuperset(name.lstrip("/") for name in nodes or ())
        and of_nodes.issuperset(parameters or ())
        and known.issuperset(signals or ())
    )


def _choose(
    seen: Seen,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
    chooser: Chooser,
) -> tuple[list[SeenNode], list[ParameterOffer], list[SignalOffer]]:
    """Choose nodes and parameters to tune, and signals to record."""
    tuned, chosen = _choose_parameters(seen, nodes, parameters, chooser)
    near = suggested_signals(seen.topics, [node.name for node in tuned])
    recorded = chooser.choose(
        "signals",
        signals,
        [offer for topic in seen.topics for offer in signal_offers(topic)],
        near,
        _signal_names,
        lambda offer: [str(offer), shown(offer.topic.fields[offer.field]), offer.remark],
    )
    return tuned, chosen, recorded


def _choose_parameters(
    seen: Seen,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    chooser: Chooser,
) -> tuple[list[SeenNode], list[ParameterOffer]]:
    """Choose nodes and parameters to tune."""
    offers, left = {}, {}
    for node in seen.nodes:
        offers[node.name], left[node.name] = parameter_offers(node)
    # Parameters that are named may be of any node.
    suggested = _suggested_nodes(seen, offers) if parameters is None else list(offers)
    tuned = chooser.choose(
        "nodes",
        None if nodes is None else [name.lstrip("/") for name in nodes],
        [node for node in seen.nodes if offers[node.name]],
        [node for node in seen.nodes if node.name in suggested],
        lambda node: [node.name],
        lambda node: [node.name, "", f"{counted(len(offers[node.name]), 'parameter')} to tune"],
    )
    of_nodes = [offer for node in tuned for offer in offers[node.name]]
    for node in tuned:
        for name, why in left[node.name].items():
            if set(parameters or ()).intersection(_parameter_names(node.name, name)):
                raise StudyError(f"--parameters: {name} of {node.name} is not offered: {why}")
    chosen = chooser.choose(
        "parameters",
        parameters,
        of_nodes,
        suggested_parameters(of_nodes),
        lambda offer: _parameter_names(offer.node, offer.name),
        lambda offer: [str(offer), shown(offer.fields["default"]), offer.remark],
    )
    return tuned, chosen


def _suggested_nodes(seen: Seen, offers: Mapping[str, Sequence[ParameterOffer]]) -> Collection[str]:
    """Return the nodes that are tuned unless the user says otherwise: a controller, no plant."""
    plants = [node.name for node in seen.nodes if is_plant(node, seen.topics)]
    controllers = suggested_nodes({k: own for k, own in offers.items() if k not in plants})
    # A simulation may close a loop of its own, with gains.
    closed = {k: [o for o in offers[k] if o.kind is Kind.TUNING] for k in plants}
    commanded = [node.name for node in seen.nodes if is_commanded(node, seen.topics)]
    controllers = [name for name in controllers if name not in commanded] or controllers
    suggested = controllers or suggested_nodes(closed)
    if plants and not suggested:
        say(
            f"note: {', '.join(plants)}: a plant by its topics and parameters; no node that "
            "controls it, or estimates its state, was seen: is it running?"
        )
    return suggested


def _parameter_names(node: str, name: str) -> list[str]:
    """Return what an option may call a parameter."""
    return [f"{node}:{name}", name]


def _signal_names(offer: SignalOffer) -> list[str]:
    """Return what an option may call a signal: its topic stands for those that have a value."""
    of_topic = signal_offers(offer.topic)
    is_taken = offer.is_finite or not any(other.is_finite for other in of_topic)
    return [str(offer), offer.topic.name] if is_taken else [str(offer)]


def _check_path(path: Path) -> None:
    if path.exists() or path.is_symlink():
        raise StudyError(f"{path}: already exists and is not overwritten; give another name")
    if not path.absolute().parent.is_dir():
        raise StudyError(f"{path}: there is no folder {path.parent}")
