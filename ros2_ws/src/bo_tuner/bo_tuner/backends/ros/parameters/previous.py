"""What attached nodes had before a tuner came: noted on disk, and given back in the end.

A tuner that is killed leaves nodes with the parameters of its last evaluation, and one that ends
may leave them with the study's safe ones. Whoever reads them next must not take these for the
nodes' own.
"""

import contextlib
import json
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.isolation import place_name
from bo_tuner.backends.ros.parameters.nodes import NodeParameters, Unset, Values
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.errors import BackendError, OutputError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.state import state_folder
from bo_tuner.study.checks import same_value
from bo_tuner.study.safe_values import named_safe, set_by_steps
from bo_tuner.study.study import Study
from bo_tuner.text import brief, shown

PATIENCE = 5.0
"""Time [s] in which a node that does not take back what it had is asked again: it may be at work
still after a run that failed, or hang."""
PAUSE = 0.25
"""Time [s] between two such attempts."""


def said_of_killed(node: str, name: str, value: object) -> str:
    """Tell that a parameter of a node has a value of a run that was killed."""
    return f"{node}: {name} is {brief(str(value))}, which a run that was killed has left"


class ParameterNote:
    """The file of one domain and namespace, in which one tuner works at a time.

    Parameters
    ----------
    domain
        The ROS domain.
    namespace
        The namespace of the tuner.

    Attributes
    ----------
    content : dict
        By the nodes' names what they had when the last tuner came and must have again
        (``previous``), by parameter the values that a tuner has told them last (``told``), and what
        of that they had before the first of several tuners that left it parked (``original``).
        Nodes of other studies stay in it.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        self._name = f"{place_name(domain, namespace)}.json"
        self.content: dict[str, Any] = {}
        # What cannot be read is of no use, and replaced.
        with contextlib.suppress(
            OutputError, OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError
        ):
            self.content = {
                node: {part: dict(item[part]) for part in ("previous", "told", "original")}
                for node, item in json.loads(read_text(self._path())).items()
            }

    def left_behind(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before, of what it still has as a tuner has told it.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, is not among it.
        """
        return self._told(node, "previous", now)

    def original(self, node: str, now: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before any tuner, of what it still has as one has left it parked.

        As in `left_behind`, what has been set since then is not among it.
        """
        return self._told(node, "original", now)

    def _told(self, node: str, part: str, now: Mapping[str, object]) -> dict[str, object]:
        noted = self.content.get(node, {})
        found = {}
        for name, value in noted.get(part, {}).items():
            told = [*noted["told"].get(name, []), noted["previous"].get(name)]
            is_told = name in now and any(same_value(now[name], item) for item in told)
            if is_told and not same_value(now[name], value):
                found[name] = value
        return found

    def settle(self, node: str) -> None:
        """Take note that a node has again what it had; if that was parked, it still is."""
        noted = self.content.get(node, {})
        original = noted.get("original", {})
        self.leave(node, {name: noted["previous"].get(name) for name in original}, original)

    def leave(
        self, node: str, parked: Mapping[str, object], original: Mapping[str, object]
    ) -> None:
        """Take note that a node has what it had, but for what it is left parked with.

        Parameters
        ----------
        node
            Its name.
        parked, original
            What it is left with, and what it had before any tuner, by parameter.
        """
        self.content.pop(node, None)
        if parked:
            self.content[node] = {
                "previous": {},
                "told": {name: [value] for name, value in parked.items()},
                "original": {name: original[name] for name in parked if name in original},
            }

    def forget(self, node: str, names: Iterable[str]) -> None:
        """Forget parameters of a node, which somebody has set on purpose."""
        noted = self.content.get(node, {})
        for name in names:
            for part in ("previous", "original"):
                noted.get(part, {}).pop(name, None)
        if not (noted.get("previous") or noted.get("original")):
            self.content.pop(node, None)

    def write(self) -> None:
        """Write the content down, or no file of none; raises `OutputError`."""
        path = self._path()
        try:
            if not self.content:
                path.unlink(missing_ok=True)
                return
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
        write_atomically(path, json.dumps(self.content, default=str))

    def _path(self) -> Path:
        return state_folder() / "attached" / self._name


class PreviousParameters:
    """Notes what the nodes of a study have, tells what they are told, and sets them back.

    Parameters
    ----------
    study
        The study.
    tuner
        The tuner's node, alone in its domain and namespace.
    parameters
        Sets and reads those of the nodes.
    """

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters
        self._note = ParameterNote(tuner.domain, tuner.node.get_namespace())
        self._previous: dict[str, dict[str, object]] = {}
        self._original: dict[str, dict[str, object]] = {}
        self._safe: Values = {}

    def undo_killed(self, found: dict[str, dict[str, object]]) -> None:
        """Set back what a killed tuner has left on the nodes.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, stays as it is.

        Parameters
        ----------
        found
            What nodes have, by key; changed along with them.

        Raises
        ------
        BackendError
            If a node refuses.
        LostError
            If it does not answer.
        """
        for key in found:
            spec = self._study.nodes[key]
            left = self._note.left_behind(spec.node, found[key])
            if not left:
                continue
            changes = ", ".join(
                f"{name} {brief(str(found[key][name]))} -> {brief(str(value))}"
                for name, value in left.items()
            )
            self._tuner.warn(f"{spec.node} is restored after a killed run: {changes}")
            try:
                self._parameters.assign_and_read_back(key, left)
            except RefusedError as refusal:
                raise BackendError(f"{spec.node} could not be restored: {refusal}") from refusal
            found[key] = self._parameters.read_anew(key)
            self._note.settle(spec.node)
            self._write()

    def begin(self, previous: Values, safe: Values) -> None:
        """Note what nodes have, by key, and what they will have between evaluations."""
        self._previous = {key: dict(values) for key, values in previous.items()}
        self._original = {
            key: self._note.original(self._study.nodes[key].node, values)
            for key, values in previous.items()
        }
        self._safe = safe
        # The constants are set next.
        self.tell({key: spec.parameters for key, spec in self._study.nodes.items()})

    @property
    def before_tuning(self) -> Values:
        """What nodes had, by key, before this tuner, or an earlier one that left them parked."""
        return {key: values | self._original[key] for key, values in self._previous.items()}

    def tell(self, told: Values) -> None:
        """Note what nodes, by key, are about to have, ahead of telling them.

        What a node was told before stays noted until it is known what it has.
        """
        steps = set_by_steps(self._study)
        for key, values in self._previous.items():
            node, known = self._study.nodes[key].node, self._parameters.known(key)
            earlier = self._note.content.get(node, {}).get("told", {})
            by_name = {}
            for name in values:
                sets = (self._safe.get(key, {}), known, told.get(key, {}))
                by_name[name] = [s[name] for s in sets if name in s]
                # A step may set it at any time.
                by_name[name] += steps.get(key, {}).get(name, [])
                if name not in known:
                    by_name[name] += earlier.get(name, [])
            original = self._original[key]
            entry = {"previous": values, "told": by_name, "original": original}
            self._note.content[node] = entry
        self._write()

    def restore(self, timeout: float) -> list[str]:
        """Give the nodes back what they had, but for safe parameters that the study names.

        A node may refuse these beside the others. It gets back all that it had then.

        Parameters
        ----------
        timeout
            Time [s] that all of them have to answer.

        Returns
        -------
        list of str
            What went wrong, each in a line; the note keeps what these nodes had.
        """
        previous, study = self._previous, self._study
        if not previous:
            # They were not taken over.
            return []
        safe = named_safe(study, previous)
        final = {key: values | safe.get(key, {}) for key, values in previous.items()}
        failed = self._parameters.assign_side_by_side(final, timeout)
        refused = {
            key: failed.pop(key)
            for key in list(failed)
            if safe.get(key) and isinstance(failed[key], RefusedError)
        }
        again = {key: previous[key] for key in refused}
        failed |= self._parameters.assign_side_by_side(again, timeout)
        failed = self._restore_late(failed, final | again, timeout)
        for key in previous.keys() - failed.keys():
            # What an earlier tuner has left parked, and this one has given back like that.
            parked = {name: previous[key][name] for name in self._original[key]}
            if key not in refused:
                parked |= safe.get(key, {})
            self._note.leave(study.nodes[key].node, parked, self.before_tuning[key])
        self._write()
        for key, values in safe.items():
            if key in failed or not values:
                continue
            left = _left_parked(values, previous[key])
            if key in refused:
                left = f"is left with what it had, and not with the park values: {refused[key]}"
            self._tuner.warn(f"{study.nodes[key].node} {left}")
        return [
            f"{study.nodes[key].node} could not be restored: {why}" for key, why in failed.items()
        ]

    def _restore_late(
        self, failed: dict[str, Unset], final: Values, timeout: float
    ) -> dict[str, Unset]:
        """Set what nodes are to have in the end and did not take; returns those that fail again."""
        deadline = time.monotonic() + PATIENCE
        while failed and time.monotonic() < deadline:
            self._tuner.spin_for(PAUSE)
            again = {key: final[key] for key in failed}
            failed = self._parameters.assign_side_by_side(again, timeout)
        return failed

    def _write(self) -> None:
        """Write the note, without which a run goes on all the same."""
        try:
            self._note.write()
        except OutputError as error:
            self._tuner.warn(f"{error}; after a kill the nodes cannot be restored")


def undo_killed(study: Study, tuner: TunerNode) -> None:
    """Set back what a killed tuner has left on the nodes of a study that are there.

    One that does not take it is told, and stays for the next tuner.
    """
    note = ParameterNote(tuner.domain, tuner.node.get_namespace())
    running = set(others.nodes(tuner.node))
    nodes = {
        key: spec.node
        for key, spec in study.nodes.items()
        if spec.node in note.content and spec.node in running
    }
    if not nodes:
        return
    parameters = NodeParameters(tuner, nodes)
    previous = PreviousParameters(study, tuner, parameters)
    for key in nodes:
        try:
            previous.undo_killed({key: parameters.read_anew(key)})
        except (BackendError, LostError) as error:
            tuner.warn(str(error))


def _left_parked(values: Mapping[str, object], previous: Mapping[str, object]) -> str:
    """Tell in a few words with which safe values a node is left, and which it had before."""
    texts = [f"{n} {_shown(v)} (was {_shown(previous.get(n))})" for n, v in values.items()]
    return f"is left with the park values: {', '.join(texts)}"


def _shown(value: object) -> str:
    if isinstance(value, bool | float):
        return shown(value)
    return "not set" if value is None else brief(str(value))
