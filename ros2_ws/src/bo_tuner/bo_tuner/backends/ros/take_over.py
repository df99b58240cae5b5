"""What nodes have is noted before the tuner sets anything, and held from then on."""

from pathlib import Path
from typing import NamedTuple

from bo_tuner.backends.ros.held_parameters import (
    compare_with_earlier,
    divide,
    note_previous,
    safe_parameters,
)
from bo_tuner.backends.ros.initial_parameters import InitialParameters
from bo_tuner.backends.ros.node_parameters import NodeParameters, Values
from bo_tuner.backends.ros.previous_parameters import PreviousParameters
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.study.study import Study


class TakenOver(NamedTuple):
    """By node key, what the nodes of a study have outside of evaluations.

    Attributes
    ----------
    safe : dict
        The safe parameters.
    held : dict
        All that the nodes had, with the constants of the study.
    """

    safe: Values
    held: Values


def take_over(
    study: Study,
    tuner: TunerNode,
    parameters: NodeParameters,
    previous: PreviousParameters | None,
    folder: Path,
    *,
    is_repeat: bool,
) -> TakenOver:
    """Note what the nodes of a study have, then set constant and safe parameters.

    Parameters
    ----------
    study
        The study.
    tuner
        The tuner's node.
    parameters
        Sets and reads those of the nodes.
    previous
        Notes what attached nodes have; None of nodes that the tuner has started.
    folder
        Log directory of the run, with what its nodes had when it began.
    is_repeat
        Whether it is that of an earlier run, which is only read.

    Raises
    ------
    BackendError
        If, attached, a parameter that the study does not set is not what it was, or a node does
        not take back what it had before a tuner that was killed.
    LostError
        If a node does not answer.
    StudyError
        If a node does not take its parameters.
    """
    found = {key: parameters.read_anew(key) for key in study.nodes}
    if previous is not None:
        previous.undo_killed(found)
    own, others = divide(study, found)
    safe = safe_parameters(study)
    if previous is not None:
        previous.begin(own, safe)
        if not is_repeat:
            note_previous(folder, previous.before_tuning)
    initial = InitialParameters(study, tuner, parameters)
    initial.set_constants()
    is_first = compare_with_earlier(folder, others, refuse=previous is not None, note=not is_repeat)
    if is_first:
        initial.refuse_ranges()
    initial.set_undeclared(found)
    if study.run is not None:
        # The nodes run by themselves, and from now on as they will between two runs.
        initial.set_safe(safe)
    held = {key: found[key] | dict(spec.parameters) for key, spec in study.nodes.items()}
    return TakenOver(safe, held)
