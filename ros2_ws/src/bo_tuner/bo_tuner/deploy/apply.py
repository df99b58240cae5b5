"""Setting the result of a run on live nodes: certified, all or nothing, read back."""

from collections.abc import Mapping
from typing import Protocol

from bo_tuner.errors import BoTunerError
from bo_tuner.storage.parameter_file import NodeValues
from bo_tuner.study import checks
from bo_tuner.text import brief


class ApplyError(BoTunerError, RuntimeError):
    """The values could not be set; the text says which values the nodes have now."""


class NodeError(BoTunerError, RuntimeError):
    """A node refused, is missing, or does not answer."""


class RefusedError(NodeError):
    """A node refused its parameters and keeps its previous ones."""


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
            If the node refuses them.
        NodeError
            If the node does not answer; it may have set them.
        """


def read_values(nodes: Nodes, like: NodeValues) -> dict[str, dict[str, object]]:
    """Read from live nodes the parameters that are in `like`.

    Raises
    ------
    NodeError
        As in `Nodes.get`.
    """
    return {node: nodes.get(node, list(values)) for node, values in like.items()}


def set_values(nodes: Nodes, before: NodeValues, new: NodeValues) -> None:
    """Set values on live nodes, and read them back.

    If a node refuses, does not answer or reads back another value, the previous values of all are
    restored.

    Parameters
    ----------
    nodes
        The live nodes.
    before
        Their present values.
    new
        The values to set, of the same nodes and parameters.

    Raises
    ------
    ApplyError
        If the nodes do not have the new values. One line.
    """
    touched: list[str] = []
    try:
        for node, values in new.items():
            touched.append(node)
            try:
                nodes.set(node, values)
            except RefusedError:
                touched.remove(node)
                raise
        for node, values in new.items():
            found = nodes.get(node, list(values))
            for name, value in values.items():
                if not checks.same_value(found[name], value):
                    shown = brief(str(found[name]))
                    raise NodeError(f"{node}: {name} is {shown} after it was set to {value}")
    except NodeError as error:
        raise ApplyError(f"{error}; {_set_back(nodes, before, touched)}") from error


def _set_back(nodes: Nodes, before: NodeValues, touched: list[str]) -> str:
    """Restore the previous values of nodes; return the outcome in words."""
    failed = []
    for node in touched:
        try:
            nodes.set(node, before[node])
        except NodeError as error:
            failed.append(f"{node} could not be restored: {error}")
    if failed:
        return "; ".join(failed)
    return f"previous values of {', '.join(touched)} restored" if touched else "nothing was changed"
