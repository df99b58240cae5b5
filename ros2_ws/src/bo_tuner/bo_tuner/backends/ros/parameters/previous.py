"""What attached nodes had before a tuner came: noted on disk, and given back in the end."""

import time
from collections.abc import Callable, Mapping

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.parameters.nodes import NodeParameters, Unset
from bo_tuner.backends.ros.parameters.note import ParameterNote
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, TunerNode
from bo_tuner.errors import BackendError, OutputError
from bo_tuner.study.safe_values import named_safe, safe_values, set_by_steps
from bo_tuner.study.study import Study
from bo_tuner.text import brief, shown

PATIENCE = 5.0
"""Time [s] in which a node that does not take back what it had is asked again: it may be at work
still after a run that failed, or hang."""
PAUSE = 0.25
"""Time [s] between two such attempts."""


class PreviousParameters:
    """Notes what the nodes of a study have and what is set on them, and sets them back."""

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters
        self._note = ParameterNote(tuner.domain, tuner.node.get_namespace())
        self._previous: dict[str, dict[str, object]] = {}
        self._original: dict[str, dict[str, object]] = {}
        self._unset: dict[str, set[str]] = {}
        self._undeclared: dict[str, set[str]] = {}
        self._safe: Values = {}

    def undo_killed(self, current: dict[str, dict[str, object]]) -> None:
        """Set back what a killed tuner has left on the nodes.

        A parameter that has another value by now, since the node was started anew or somebody has
        set it, stays as it is.
        """
        for key in current:
            spec = self._study.nodes[key]
            left = self._note.left_behind(spec.node, current[key])
            unset = self._note.left_set(spec.node, current[key])
            if not left and not unset:
                continue
            changes = ", ".join(
                f"{name} {brief(str(current[key][name]))} -> {brief(str(value))}"
                for name, value in (left | dict.fromkeys(unset, "not set")).items()
            )
            self._tuner.warn(f"{spec.node} is restored after a killed run: {changes}")
            try:
                self._parameters.assign_and_read_back(key, left)
            except RefusedError as refusal:
                raise BackendError(f"{spec.node} could not be restored: {refusal}") from refusal
            undeclared = self._note.undeclared(spec.node)
            safe = safe_values(self._study).get(key, {})
            self._unset_again({key: unset}, {key: undeclared}, {key: safe}, CALL_TIMEOUT)
            current[key] = self._parameters.read_anew(key)
            self._note.settle(spec.node)
            self._write()

    def begin(self, previous: Values, safe: Values) -> None:
        """Note what nodes have, by key, and what they will have between evaluations."""
        self._previous = {key: dict(values) for key, values in previous.items()}
        self._original = {
            key: self._note.original(self._study.nodes[key].node, values)
            for key, values in previous.items()
        }
        self._unset = {
            key: names - previous[key].keys() for key, names in self._study.own_parameters.items()
        }
        self._undeclared = {key: self._parameters.undeclared(key) for key in previous}
        self._safe = safe
        # The constants are set next.
        self.announce({key: spec.parameters for key, spec in self._study.nodes.items()})

    @property
    def before_tuning(self) -> Values:
        """What nodes had, by key, before this tuner, or an earlier one that left them parked."""
        return {key: values | self._original[key] for key, values in self._previous.items()}

    def announce(self, *wanted: Values) -> None:
        """Note what is about to be set on nodes, by key; of several sets, one after the other.

        Values that were set before stay noted until it is known what the node has.
        """
        steps = set_by_steps(self._study)
        for key, values in self._previous.items():
            node, known = self._study.nodes[key].node, self._parameters.known(key)
            earlier = self._note.assigned(node)
            by_name = {}
            had = values | dict.fromkeys(self._unset[key])
            for name in had:
                sets = (self._safe.get(key, {}), known, *(each.get(key, {}) for each in wanted))
                by_name[name] = [s[name] for s in sets if name in s]
                # A step may set it at any time.
                by_name[name] += steps.get(key, {}).get(name, [])
                if name not in known:
                    by_name[name] += earlier.get(name, [])
            self._note.note(node, had, by_name, self._original[key], self._undeclared[key])
        self._write()

    def restore(self, timeout: float, approach: Callable[[Values, float], object]) -> list[str]:
        """Give the nodes back what they had, but for safe parameters that the study names.

        What had no value has none again, as far as a node allows that; the rest is returned.

        A node may refuse these beside the others. It gets back all that it had then.
        """
        previous, study = self._previous, self._study
        if not previous:
            # They were not taken over.
            return []
        safe = named_safe(study, previous)
        final = {key: values | safe.get(key, {}) for key, values in previous.items()}
        approach(final, timeout)
        failed = self._parameters.assign_side_by_side(final, timeout)
        refused = {
            key: failed.pop(key)
            for key in list(failed)
            if safe.get(key) and isinstance(failed[key], RefusedError)
        }
        again = {key: previous[key] for key in refused}
        failed |= self._parameters.assign_side_by_side(again, timeout)
        failed = self._restore_late(failed, final | again, timeout)
        given_back = previous.keys() - failed.keys()
        self._unset_again(
            {
                key: self._unset[key] - (set() if key in refused else safe.get(key, {}).keys())
                for key in given_back
            },
            self._undeclared,
            self._safe,
            timeout,
        )
        for key in given_back:
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

    def _unset_again(
        self,
        names: Mapping[str, set[str]],
        undeclared: Mapping[str, set[str]],
        safe: Values,
        timeout: float,
    ) -> None:
        """Take back what had no value, by node key, and warn where that is not possible."""
        kept = {
            key: {
                name: "it is declared, and would be no longer"
                for name in sorted(unset - undeclared[key])
                if name in self._parameters.known(key)
            }
            for key, unset in names.items()
        }
        deleted = {key: unset & undeclared[key] for key, unset in names.items()}
        for key, left in self._parameters.unset_side_by_side(deleted, timeout).items():
            kept[key] |= left
        for key, left in kept.items():
            for name, why in left.items():
                node = self._study.nodes[key].node
                self._tuner.warn(f"{node}: {name} was not set before, and cannot be again: {why}")
        self._parameters.assign_side_by_side(
            {
                key: {name: v for name, v in safe.get(key, {}).items() if name in left}
                for key, left in kept.items()
            },
            timeout,
        )

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

    A warning names a node that does not take it, which stays noted for the next tuner.
    """
    note = ParameterNote(tuner.domain, tuner.node.get_namespace())
    nodes = {
        key: spec.node
        for key, spec in study.nodes.items()
        if note.knows(spec.node) and others.running([spec.node], tuner.node)
    }
    if not nodes:
        return
    parameters = NodeParameters(tuner, nodes, study.own_parameters)
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
