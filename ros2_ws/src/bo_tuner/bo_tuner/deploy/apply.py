"""Setting values on live nodes: on all of them or none, and read back."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bo_tuner.codec import checks
from bo_tuner.errors import BoTunerError
from bo_tuner.interruption import Interrupted
from bo_tuner.storage.parameter_file import NodeValues
from bo_tuner.study.ramping import Ramp
from bo_tuner.study.study import Study
from bo_tuner.text import brief


class ApplyError(BoTunerError, RuntimeError):
    """The values could not be set; the text says which values the nodes have now.

    Attributes
    ----------
    restored
        Whether all nodes have their previous values.
    """

    def __init__(self, text: str, *, restored: bool) -> None:
        super().__init__(text)
        self.restored = restored


class NodeError(BoTunerError, RuntimeError):
    """A node refused, is missing, or does not answer."""


class RefusedError(NodeError):
    """A node refused its parameters, or did not get them, and keeps its previous ones."""


class Nodes(Protocol):
    """Access to the parameters of live nodes, by node name."""

    def get(self, node: str, names: list[str]) -> dict[str, object]:
        """Read parameters of a node.

        Raises
        ------
        NodeError
            If the node does not answer, or does not have one of them.
        """

    def set(self, node: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node, all of them or none.

        Raises
        ------
        RefusedError
            If the node refuses them, or does not get them.
        NodeError
            If the node does not answer; it may have set them.
        """

    def is_configured(self, node: str) -> bool:
        """Return whether a node takes its values only when it is configured."""

    def configure(self, node: str) -> None:
        """Have a node that `is_configured` take its values; raises `NodeError` if it does not."""

    def wait(self, period: float) -> None:
        """Wait for so many seconds; raises `Interrupted` if somebody asks for the end."""

    def undisturbed(self) -> contextlib.AbstractContextManager[None]:
        """Let nobody end anything within."""

    def watch(self, values: NodeValues) -> None:
        """Watch for a while whether nodes keep the values that were set.

        Raises
        ------
        NodeError
            If a node reports that it has another one.
        """


def read_values(nodes: Nodes, like: NodeValues) -> dict[str, dict[str, object]]:
    """Read from live nodes the parameters that are in `like`."""
    return {node: nodes.get(node, list(values)) for node, values in like.items()}


@dataclass(frozen=True)
class Way:
    """The steps of nodes to new values, which are none of them; by default without any.

    Attributes
    ----------
    steps : sequence of NodeValues
        What changes in each.
    period : float
        Time [s] ahead of each, and ahead of the new values.
    """

    steps: Sequence[NodeValues] = ()
    period: float = 0.0

    @classmethod
    def of(cls, study: Study, before: NodeValues, new: NodeValues) -> "Way":
        """Return that of the ramp of a study, by the names of its nodes."""
        ramp, keys = Ramp(study), {spec.node: key for key, spec in study.nodes.items()}
        ends = ({keys[node]: v for node, v in values.items()} for values in (before, new))
        return cls(
            [
                {study.nodes[key].node: of_node for key, of_node in step.items()}
                for step in ramp.steps(*ends)
            ],
            ramp.period,
        )


AT_ONCE = Way()


def set_values(
    nodes: Nodes,
    before: NodeValues,
    new: NodeValues,
    way: Way = AT_ONCE,
    commit: Callable[[], object] = lambda: None,
) -> None:
    """Set on live nodes what they have otherwise, and read all values back, twice.

    A node may take values and go back on them when it next computes with them, so they are watched
    for a while between the two readings. If a node refuses, does not answer or has another value,
    or somebody asks for the end on the way, the previous values of all are restored at once, in
    reverse order, and read back.
    """
    touched: list[str] = []
    try:
        for step in way.steps:
            nodes.wait(way.period)
            for node, values in step.items():
                _set(nodes, node, values, touched)
        if way.steps:
            nodes.wait(way.period)
        commit()
        for node, values in new.items():
            if changes := _changes(before[node], values):
                _set(nodes, node, changes, touched)
        for node, values in new.items():
            _read_back(nodes, node, values)
            if nodes.is_configured(node):
                touched += [node] * (node not in touched)
                nodes.configure(node)
        if touched:
            nodes.watch(new)
            for node, values in new.items():
                _read_back(nodes, node, values)
    except (NodeError, Interrupted) as error:
        # What was set last goes first, as the nodes had it together before.
        with nodes.undisturbed():
            failed = _set_back(nodes, {node: before[node] for node in reversed(touched)}, new)
        why = str(error)
        if isinstance(error, Interrupted):
            if not failed:
                raise
            why = f"interrupted by {error}"
        done = f"previous values of {', '.join(touched)} restored"
        outcome = "; ".join(failed) or (done if touched else "nothing was changed")
        raise ApplyError(f"{why}; {outcome}", restored=not failed) from error


def _set(nodes: Nodes, node: str, values: Mapping[str, object], touched: list[str]) -> None:
    """Set values of a node, and add it to those that may have others than before."""
    is_first = node not in touched
    if is_first:
        touched.append(node)
    try:
        nodes.set(node, values)
    except RefusedError:
        if is_first:
            touched.remove(node)
        raise


def _set_back(nodes: Nodes, before: NodeValues, new: NodeValues) -> list[str]:
    """Restore values of nodes, and read them back; return what failed, a line for each node."""
    failed = []
    for node, values in before.items():
        try:
            if changes := _changes(new[node], values):
                nodes.set(node, changes)
            # A node may have changed others along with those that were set.
            if others := _changes(nodes.get(node, list(values)), values):
                nodes.set(node, others)
            _read_back(nodes, node, values)
            if nodes.is_configured(node):
                nodes.configure(node)
        except NodeError as error:
            failed.append(f"{node} could not be restored: {error}")
    return failed


def _read_back(nodes: Nodes, node: str, values: Mapping[str, object]) -> None:
    """Raise `NodeError` if a node does not have the values that were set."""
    actual = nodes.get(node, list(values))
    for name, value in values.items():
        if not checks.holds(actual[name], value):
            shown = brief(str(actual[name]))
            raise NodeError(f"{node}: {name} is {shown} after it was set to {value}")


def _changes(before: Mapping[str, object], new: Mapping[str, object]) -> dict[str, object]:
    """Return the values that differ; a node may refuse to have others set, as read-only ones."""
    return {name: v for name, v in new.items() if not checks.holds(before[name], v)}
