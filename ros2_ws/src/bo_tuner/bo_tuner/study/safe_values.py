"""The values that a study's nodes have while no run is performed, by node."""

from collections.abc import Mapping

from bo_tuner.codec.checks import holds
from bo_tuner.study.run import AFTER
from bo_tuner.study.study import Study
from bo_tuner.trials import Value


def safe_values(study: Study) -> dict[str, dict[str, object]]:
    """Return by node key the parameters that nodes have while no run is performed."""
    safe = _whole(study)
    if study.seed_parameter is not None:
        del safe[study.seed_parameter.node][study.seed_parameter.parameter]
    for key, values in _left_by_steps(study).items():
        safe.setdefault(key, {}).update(values)
    return safe


def safe_in_braces(study: Study) -> dict[str, Value]:
    """Return the values that names in braces stand for while no run is performed."""
    contexts = study.context_space()
    return {**study.safe_parameters, **contexts.to_dict(contexts.nominal())}


def set_by_steps(study: Study) -> dict[str, dict[str, list[object]]]:
    """Return by node key, then by parameter, the values that steps set."""
    by_node: dict[str, dict[str, list[object]]] = {}
    for _, item in study.settings:
        by_node.setdefault(item.node, {}).setdefault(item.parameter, []).append(item.value)
    return by_node


def _left_by_steps(study: Study) -> dict[str, dict[str, object]]:
    """Return by node key the values between two runs of the parameters that steps set.

    A value is that of the last step of `after`, or else a constant of the node.
    """
    by_node: dict[str, dict[str, object]] = {}
    settings = list(study.settings)
    for _, item in settings:
        constants = study.nodes[item.node].parameters
        if item.parameter in constants:
            by_node.setdefault(item.node, {})[item.parameter] = constants[item.parameter]
    for path, item in settings:
        if path[1] == AFTER:
            by_node.setdefault(item.node, {})[item.parameter] = item.value
    return by_node


def named_safe(
    study: Study, previous: Mapping[str, Mapping[str, object]]
) -> dict[str, dict[str, object]]:
    """Return by node key the values of ``park`` that the nodes do not have yet.

    Parameters
    ----------
    study
        The study.
    previous
        Present values of the nodes, by key. Items of an array that ``park`` does not name are kept.
    """
    safe, whole = study.safe_parameters, _whole(study)
    by_node: dict[str, dict[str, object]] = {}
    for item in study.parameters_of_nodes:
        if item.name not in study.park.parameters:
            continue
        of_node = by_node.setdefault(item.node, {})
        if not item.array:
            of_node[item.parameter] = item.as_sent(safe[item.name])
            continue
        had = of_node.get(item.array, previous[item.node].get(item.array))
        if isinstance(had, list) and item.item < len(had):
            of_node[item.array] = [*had[: item.item], safe[item.name], *had[item.item + 1 :]]
        else:
            of_node[item.array] = whole[item.node][item.array]
    return {
        key: {n: v for n, v in values.items() if not holds(previous[key].get(n), v)}
        for key, values in by_node.items()
    }


def _whole(study: Study) -> dict[str, dict[str, object]]:
    assigned = study.nominal_assignments(study.safe_parameters)
    return {key: dict(values) for key, values in assigned.items()}
