"""Which parameters nodes take only while they start, and who starts these nodes."""

from collections.abc import Mapping

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
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

    An array is taken with all of its items, as the node takes it as a whole.

    Raises
    ------
    StudyError
        If a name is of no parameter that the study sets on the node, the study sets none there, or
        a node passes on a parameter file that would be empty.
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
    """Return the key of the node that brings a node its values when it starts; None without any.

    It is the node itself if the study says how to start it, and otherwise the node that passes the
    parameter file on.
    """
    if nodes[key].is_started:
        return key
    passing = [other for other, spec in nodes.items() if spec.passes_file]
    return passing[0] if len(passing) == 1 else None
