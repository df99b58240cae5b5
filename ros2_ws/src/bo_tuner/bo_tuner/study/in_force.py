"""Which values are in force in the runs of a study, and how that is known."""

from bo_tuner.study.nodes import CONTROLLER_MANAGER
from bo_tuner.study.step_values import senders
from bo_tuner.study.study import Study
from bo_tuner.text import listed


def in_force(study: Study) -> tuple[str, ...]:
    """Say in a line each how it is known that parameter sets are in force on nodes of ROS."""
    ways: dict[str, list[str]] = {}
    for name, item in study.parameters.items():
        if item.node:
            at_start = study.start_names.get(item.node, frozenset())
            way = _on_node(study, item.node, (item.array or item.parameter) in at_start)
        else:
            places = listed(senders(study.run, study.nodes, name))
            way = f"as it stands in {places}, which nothing reads back"
        ways.setdefault(way, []).append(name)
    return tuple(f"in force: {listed(names)}, {way}" for way, names in ways.items())


def _on_node(study: Study, key: str, at_start: bool) -> str:
    """Say how values come into force on a node, and how that is known."""
    spec = study.nodes[key]
    if not at_start:
        return f"set on {spec.node} while it runs, and read back"
    if not spec.reconfigure:
        return f"given to {spec.node} at its start, and read back"
    by = "when it is configured anew"
    if spec.reconfigure == CONTROLLER_MANAGER:
        by = f"once the {CONTROLLER_MANAGER} has configured it anew"
    elif isinstance(spec.reconfigure, tuple):
        by = "once its steps of reconfigure are done"
    return f"set on {spec.node} and read back, {by}"
