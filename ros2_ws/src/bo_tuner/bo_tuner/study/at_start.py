"""Which parameters nodes take only while they start, and who starts these nodes."""

from collections.abc import Mapping

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.nodes import PARAMETER_FILE, NodeSpec
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parts import ContextVariable, SeedParameter

Names = Mapping[str, frozenset[str]]
"""Names of parameters as the nodes have them, by node key."""


def start_names(
    nodes: Mapping[str, NodeSpec],
    parameters: Mapping[str, Parameter],
    contexts: Mapping[str, ContextVariable],
    seed: SeedParameter | None,
) -> dict[str, frozenset[str]]:
    """Return what the nodes with ``at_start`` take at their start, by their keys.

    Of an array all items are, as a node takes it as a whole.

    Raises
    ------
    StudyError
        If a name is of nothing that the study sets on the node, it sets nothing there, or a node
        passes a file on in which nothing would be.
    """
    by_node: dict[str, frozenset[str]] = {}
    for key, spec in nodes.items():
        if not spec.at_start:
            continue
        path = ("nodes", key, "at_start")
        own = {name: name for name in spec.parameters}
        for section in (parameters, contexts):
            for name, item in section.items():
                if item.node == key:
                    own[name] = getattr(item, "array", "") or item.parameter
        if seed is not None and seed.node == key:
            own[seed.parameter] = seed.parameter
        if not own:
            raise StudyError("the study sets no parameter of this node", path)
        if isinstance(spec.at_start, tuple):
            for index, name in enumerate(spec.at_start):
                checks.reference(name, "parameter of the node", own, *path, index)
            own = {name: own[name] for name in spec.at_start}
        by_node[key] = frozenset(own.values())
    for key, spec in nodes.items():
        if spec.passes_file and all(starter_of(nodes, other) != key for other in by_node):
            raise StudyError(
                f"nothing would be in {PARAMETER_FILE}: add at_start: true to the node",
                ("nodes", key, "launch" if spec.launch else "command"),
            )
    return by_node


def starter_of(nodes: Mapping[str, NodeSpec], key: str) -> str | None:
    """Return the key of the node whose start brings the values of a node; None if there is none.

    A node that says how to start it is its own; others start along with the one that passes the
    file on.
    """
    if nodes[key].is_started:
        return key
    passing = [other for other, spec in nodes.items() if spec.passes_file]
    return passing[0] if len(passing) == 1 else None
