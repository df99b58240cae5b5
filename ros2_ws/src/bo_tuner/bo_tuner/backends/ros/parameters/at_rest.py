"""What nodes have while no run is performed: set before all else, and held from then on."""

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.graph import describe_now
from bo_tuner.backends.ros.parameters.approach import Approach
from bo_tuner.backends.ros.parameters.events import Values, differences, offer_unwatched
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.parameters.previous import PreviousParameters
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, TunerNode
from bo_tuner.errors import BackendError, KeyPath, OutputError, StudyError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import HELD_PARAMETERS, PREVIOUS_PARAMETERS, read_text
from bo_tuner.study.descriptors import node_problems
from bo_tuner.study.safe_values import safe_values, set_by_steps
from bo_tuner.study.study import Study


class InitialParameters:
    """Sets what a study sets outside of evaluations; a refusal names the place in the study.

    All methods raise `StudyError` if a node does not take a value, and `LostError` if it does not
    answer.
    """

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters

    def set_constants(self) -> None:
        """Set the constants of the nodes, and read them back."""
        for key, spec in self._study.nodes.items():
            try:
                self._parameters.assign_and_read_back(key, spec.parameters)
            except RefusedError as refusal:
                raise self._named(key, refusal, ("nodes", key, "parameters")) from refusal

    def set_undeclared(self, declared: Mapping[str, Mapping[str, object]]) -> None:
        """Set safe values of undeclared parameters: one that is never taken costs all trials."""
        safe = self._study.nominal_assignments(self._study.safe_parameters)
        for key, values in safe.items():
            undeclared = {name: v for name, v in values.items() if name not in declared[key]}
            try:
                self._parameters.assign(key, undeclared)
            except RefusedError as refusal:
                raise self._named(key, refusal, ("nodes", key)) from refusal

    def set_safe(self, safe: Values, approach: Approach) -> None:
        """Set safe values by way of an approach, and read them back."""
        approach.as_far_as_possible(safe, CALL_TIMEOUT)
        section = "park" if self._study.park.parameters else "parameters"
        for key, values in safe.items():
            try:
                self._parameters.assign_and_read_back(key, values)
            except RefusedError as refusal:
                raise self._named(key, refusal, (section,), "as safe values: ") from refusal

    def refuse_ranges(self) -> None:
        """Refuse a study with values that a node says it does not take: they would fail runs."""
        for key in self._study.nodes:
            for problem in self._problems(key, declared=True):
                raise problem

    def _named(
        self, key: str, refusal: RefusedError, path: KeyPath, prefix: str = ""
    ) -> StudyError:
        """Return what the study sets that the node cannot take, or the node's refusal itself."""
        problems = self._problems(key, declared=False)
        return problems[0] if problems else StudyError(f"{prefix}{refusal}", path)

    def _problems(self, key: str, *, declared: bool) -> list[StudyError]:
        """Return what a node says it does not take; nothing if it does not describe parameters."""
        try:
            # The tuner has set something on it by now, and has noted that down.
            own = self._study.own_parameters[key]
            known = describe_now(self._tuner, self._study.nodes[key].node, own)
        except BackendError:
            return []
        return node_problems(self._study, key, known, declared=declared)


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
    approach: Approach,
    previous: PreviousParameters | None,
    folder: Path,
    *,
    is_repeat: bool,
) -> TakenOver:
    """Note what the nodes of a study have, then set constant and safe parameters."""
    current = {key: parameters.read_anew(key) for key in study.nodes}
    if previous is not None:
        previous.undo_killed(current)
    own, others = _divide(study, current)
    safe = safe_values(study)
    steps = set_by_steps(study)
    for key, names in steps.items():
        # What the study does not say of them is what the node has.
        had = {name: value for name, value in current[key].items() if name in names}
        safe[key] = had | safe.get(key, {})
    if previous is not None:
        previous.begin(own, safe)
        if not is_repeat:
            _note_previous(folder, previous.before_tuning)
    initial = InitialParameters(study, tuner, parameters)
    initial.set_constants()
    is_first = _compare_with_earlier(
        folder, others, refuse=previous is not None, note=not is_repeat
    )
    if is_first:
        initial.refuse_ranges()
    initial.set_undeclared(current)
    if study.run is not None:
        # The nodes run by themselves, and from now on as they will between two runs.
        initial.set_safe(safe, approach)
    held = {key: current[key] | dict(spec.parameters) for key, spec in study.nodes.items()}
    for key, names in steps.items():
        held[key] |= {name: safe[key][name] for name in names if name in safe[key]}
    return TakenOver(safe, held)


def _divide(
    study: Study, values: Values
) -> tuple[dict[str, dict[str, object]], dict[str, dict[str, object]]]:
    """Return the parameters, by node key, that a study sets, and the others."""
    own: dict[str, dict[str, object]] = {}
    others: dict[str, dict[str, object]] = {}
    for key, names in study.own_parameters.items():
        of_node = values[key]
        own[key] = {name: value for name, value in of_node.items() if name in names}
        others[key] = {name: value for name, value in of_node.items() if name not in names}
    return own, others


def _note_previous(folder: Path, values: Values) -> None:
    """Note down in a folder what nodes had, by key, unless that was done when its run began."""
    file = folder / PREVIOUS_PARAMETERS
    # Without the file the way back is to the study's defaults, which the bundle says.
    with contextlib.suppress(OutputError):
        if not file.exists():
            write_atomically(file, json.dumps(values, indent=1, default=str))


def _compare_with_earlier(folder: Path, values: Values, *, refuse: bool, note: bool) -> bool:
    """Compare parameters with those that were noted down first in a folder, or note them down.

    A validation, or the rest of a run, on attached nodes would else measure something else.
    """
    file = folder / HELD_PARAMETERS
    try:
        earlier = json.loads(read_text(file))
        known = {key: dict(earlier[key]) for key in values}
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        known = {}
    if not known:
        if note:
            with contextlib.suppress(OutputError):
                write_atomically(file, json.dumps(values, indent=1, default=str))
        return True
    if not refuse:
        return False
    for key, now in values.items():
        common = {name: known[key][name] for name in now if name in known[key]}
        if changed := differences(key, json.loads(json.dumps(now, default=str)), common):
            raise BackendError(
                f"{changed[0]}, as when the run began; set it back, or if the node changes it by "
                f"itself: {offer_unwatched(changed[0])}"
            )
    return False
