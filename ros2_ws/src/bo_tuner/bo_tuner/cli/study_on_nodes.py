"""Hold a study against its nodes, and say what is wrong."""

from collections.abc import Mapping, Sequence

from bo_tuner.backends.ros.graph import any_runs, describe, describe_now, signal_problems
from bo_tuner.backends.ros.parameters.previous import undo_killed
from bo_tuner.backends.ros.plant import plant_notes
from bo_tuner.backends.ros.preparation import run_problems
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.backends.workers.limits import problem_of_workers
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.cli.streams import say_error
from bo_tuner.codec.checks import holds
from bo_tuner.errors import BackendError
from bo_tuner.evidence.check import NodesMatch, NothingStarts, OtherClock, OtherValue
from bo_tuner.evidence.words.check import in_words
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import say
from bo_tuner.study.descriptors import Described, node_problems
from bo_tuner.study.nodes import USE_SIM_TIME
from bo_tuner.study.parts import ROS
from bo_tuner.study.run import SIM
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study
from bo_tuner.text import counted


class MistakesError(Exception):
    """The nodes do not match the study, and all that is wrong has been said."""


def is_running(study: Study, ros_arguments: Sequence[str], interruption: Interruption) -> bool:
    """Whether to use nodes that run, where the user does not say: if there are any.

    Of a study that does not say how to start them, they have to run.
    """
    return not study.starts_nodes or any_runs(
        [spec.node for spec in study.nodes.values()], ros_arguments, interruption.check
    )


def hold_against(study: Study, tuner: TunerNode, *, attached: bool) -> None:
    """Hold a study against its nodes, and say what is wrong."""
    problems, notes = _look(study, tuner, attached=attached)
    for note in notes:
        say(f"note: {note}")
    for text in problems:
        say_error(f"error: {text}")
    if problems:
        if attached:
            undo_killed(study, tuner)
        say_error(f"{counted(len(problems), 'problem')} found; nothing was set")
        raise MistakesError
    say(in_words(NodesMatch(len(study.parameters), len(study.signals))))


def _look(study: Study, tuner: TunerNode, *, attached: bool) -> tuple[list[str], list[str]]:
    """Hold parameters, signals and steps against the graph; problems and notes, a line each.

    What a run itself publishes has no publisher yet, so only signals of others are looked for.
    """
    # What was left on a node that ran before says nothing of one that is started.
    describe_node = describe if attached else describe_now
    problems: list[str] = []
    notes = [study.budget.warning] if study.budget.warning else []
    defaults = study.search_space().defaults
    absent = 0
    for key, spec in study.nodes.items():
        try:
            known = describe_node(tuner, spec.node, study.own_parameters[key])
        except BackendError as error:
            problems.append(f"nodes.{key}: {error}")
            absent += 1
            continue
        if (clock := _other_clock(study, key, known)) is not None:
            notes.append(in_words(clock))
        errors = node_problems(study, key, known)
        problems += [str(error) for error in errors]
        refused = {error.path for error in errors}
        for name, item in study.parameters.items():
            if item.node != key or item.array or name not in defaults:
                continue
            if ("parameters", name) in refused:
                continue
            described = known.get(item.parameter)
            if described is None or holds(described.value, defaults[name]):
                continue
            notes.append(in_words(OtherValue(name, described.value, defaults[name])))
    if problem := problem_of_workers(study, ROS, Workers(study.budget.workers or 1), attach=False):
        problems.append(f"budget.workers: {problem}")
    if absent == len(study.nodes):
        # Of nodes that were not started, their topics and services are not worth a line each.
        return problems, notes
    if study.run is not None and not study.run.start:
        notes.append(in_words(NothingStarts()))
    notes += plant_notes(study, tuner)
    problems += [str(error) for error in signal_problems(tuner, heard_of_others(study, tuner))]
    problems += [str(error) for error in run_problems(study, tuner, attached=attached)]
    return problems, notes


def _other_clock(study: Study, key: str, known: Mapping[str, Described]) -> OtherClock | None:
    """Return that a node has another clock than the run; None if it has the same."""
    described = known.get(USE_SIM_TIME)
    if study.run is None or described is None:
        return None
    simulated = study.nodes[key].parameters.get(USE_SIM_TIME, described.value) is True
    clock = study.run.clock
    return None if simulated == (clock == SIM) else OtherClock(key, simulated, clock)


def heard_of_others(study: Study, tuner: TunerNode) -> dict[str, Signal]:
    """Return the signals of a study that others publish than the run itself."""
    name = tuner.node.resolve_topic_name
    published = [step.publish for _, step in study.steps if step.publish is not None]
    own = {name(item.topic) for publish in published for item in publish.published}
    if study.plays_bags:
        # What a bag has shows when it is played first.
        topics = {name(spec.topic) for spec in study.signals.values()}
        own |= {topic for topic in topics if not tuner.node.count_publishers(topic)}
    return {
        key: spec
        for key, spec in study.signals.items()
        if spec.publisher or name(spec.topic) not in own
    }
