"""What nodes say of their parameters: compared with a study, or filled in where it says nothing."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.parameter import Parameter, array_and_item
from bo_tuner.study.steps import SetParameter
from bo_tuner.study.study import Study
from bo_tuner.trials import Value

ROS_TYPES = {bool: "boolean", int: "integer", float: "double", str: "string"}
"""What ROS calls the types of values."""


@dataclass(frozen=True)
class Described:
    """A parameter as its node describes it.

    Attributes
    ----------
    type
        As ROS calls it: `double`, `integer`, `boolean`, `string`, these with ``_array``, or empty
        if the parameter is not set.
    value
        Present value.
    lower, upper, step
        Its range; infinite, and 0, where it has none.
    read_only
        Whether it cannot be set.
    description
        What the node says of it in words.
    """

    type: str
    value: object
    lower: float = -math.inf
    upper: float = math.inf
    step: float = 0.0
    read_only: bool = False
    description: str = ""

    @property
    def has_range(self) -> bool:
        """Whether the value is bounded on both sides."""
        return math.isfinite(self.lower) and math.isfinite(self.upper)

    @property
    def has_steps(self) -> bool:
        """Whether it leaves out values between its steps, which of an integer are larger than 1."""
        return self.step > (1.0 if self.type == "integer" else 0.0)


Descriptions = Mapping[str, Mapping[str, Described]]
"""Descriptions by the node's key in the study, then by the parameter's name in the node."""


def incomplete(mapping: object) -> dict[str, list[str]]:
    """Return the parameters that a study file does not define in full, by node.

    Parameters
    ----------
    mapping
        The dictionaries and lists of the study file, not checked yet.

    Returns
    -------
    dict from str to list
        By the node's key the names of its parameters in the study.
    """
    lacking: dict[str, list[str]] = {}
    for name, item in _parameters(mapping).items():
        if not isinstance(item, dict) or not isinstance(item.get("node"), str):
            continue
        is_constant = "fixed" in item or "tied_to" in item
        is_number = item.get("type") in (None, "double", "integer")
        needed = {"type", *(() if is_constant else ("default",))}
        needed |= {"bounds"} if is_number and not is_constant and "choices" not in item else set()
        array, _ = array_and_item(str(item.get("parameter", name)))
        has_array = not array or array in _constants(mapping, item["node"])
        if needed - item.keys() or not has_array:
            lacking.setdefault(str(item["node"]), []).append(name)
    return lacking


def complete(mapping: dict[str, object], nodes: Descriptions) -> None:
    """Fill in what the nodes say of parameters that a study file leaves open.

    Type, bounds and step come from the descriptor, the default and an array from the present value.

    Parameters
    ----------
    mapping
        The dictionaries and lists of the study file; changed.
    nodes
        Descriptions of the parameters of the nodes that `incomplete` names.

    Raises
    ------
    StudyError
        If a parameter has no valid name, its node does not have it, or gives no range.
    """
    for key, names in incomplete(mapping).items():
        for name in names:
            item = _parameters(mapping)[name]
            path = ("parameters", name)
            in_node = checks.name_in_node(item.get("parameter", name), *path)
            array, index = array_and_item(in_node)
            wanted = array or in_node
            described = nodes[key].get(wanted)
            if described is None:
                hint = checks.suggestion(wanted, nodes[key])
                raise StudyError(f"node {key} has no parameter '{wanted}'; {hint}", path)
            value = described.value
            if array:
                if not isinstance(value, (list, tuple)):
                    raise StudyError(f"node {key}: {array} is no array", path)
                if array not in _constants(mapping, key):
                    _add_constant(mapping, key, array, list(value))
                value = value[index] if index < len(value) else None
            kind_of_node = described.type.removesuffix("_array") if array else described.type
            item.setdefault("type", kind_of_node)
            if "fixed" in item or "tied_to" in item:
                continue
            if value is not None:
                item.setdefault("default", value)
            if item["type"] not in ("double", "integer"):
                continue
            kind = int if item["type"] == "integer" else float
            if "bounds" not in item and "choices" not in item:
                if not described.has_range or array:
                    raise StudyError(
                        f"missing; node {key} gives no range for it", (*path, "bounds")
                    )
                item["bounds"] = [kind(described.lower), kind(described.upper)]
            if described.has_steps and not array and "choices" not in item:
                item.setdefault("step", kind(described.step))


def node_problems(
    study: Study, key: str, known: Mapping[str, Described], *, declared: bool = False
) -> list[StudyError]:
    """Return why a node will not take what a study sets on it, each with the place in the study.

    Parameters
    ----------
    study
        The study.
    key
        The node's, in the study.
    known
        All parameters of the node.
    declared
        Whether to judge these only: a node may take others that it has not declared.
    """
    problems = []
    for name, item in study.parameters.items():
        if item.node != key or (declared and (item.array or item.parameter) not in known):
            continue
        if text := problem(item, known, item.leader(study.parameters)):
            problems.append(StudyError(text, ("parameters", name)))
    for path, node, name in _further_parameters(study):
        if node == key and name not in known and not declared:
            problems.append(StudyError(_undeclared(name, known), path))
    for name, value in study.nodes[key].parameters.items():
        described = known.get(name)
        if described is not None and (text := _integer_for_double(name, value, described)):
            problems.append(StudyError(text, ("nodes", key, "parameters")))
    for name, variable in study.contexts.items():
        described = known.get(variable.parameter)
        if variable.node != key or described is None:
            continue
        ends = (variable.distribution.lower, variable.distribution.upper)
        text = _unsettable(variable.parameter, described, variable.type)
        if not variable.distribution.labels:
            text = text or _outside(ends, variable.parameter, described)
        if text:
            problems.append(StudyError(text, ("contexts", name)))
    for path, setting in study.settings:
        if setting.node == key and (text := _setting_problem(setting, known)):
            problems.append(StudyError(text, path))
    seed = study.seed_parameter
    described = known.get(seed.parameter) if seed is not None and seed.node == key else None
    if seed is not None and described is not None:
        text = _unsettable(seed.parameter, described, "integer")
        problems += [StudyError(text, ("seed_parameter",))] if text else []
    return problems


def _setting_problem(setting: SetParameter, known: Mapping[str, Described]) -> str:
    """Return in a line why a node will not take what a step sets; empty if it will.

    After the run the node gets its former value back, so it must have declared the parameter.
    """
    name, value = setting.parameter, setting.value
    described = known.get(name)
    if described is None:
        return _undeclared(name, known)
    items = value if isinstance(value, tuple) else (value,)
    kind = ROS_TYPES[type(items[0])] + ("_array" if isinstance(value, tuple) else "")
    numbers = [] if isinstance(value, tuple | bool | str) else [float(value)]
    return (
        _integer_for_double(name, value, described)
        or _unsettable(name, described, kind)
        or _outside(numbers, name, described)
    )


def _further_parameters(study: Study) -> Iterator[tuple[KeyPath, str, str]]:
    """Yield other parameters that a study sets: place in the study, key of the node, and name."""
    for key, spec in study.nodes.items():
        arrays = {item.array for item in study.parameters.values() if item.node == key}
        for name in spec.parameters.keys() - arrays:
            yield ("nodes", key, "parameters"), key, name
    for name, item in study.contexts.items():
        if not item.node:
            continue
        yield ("contexts", name), item.node, item.parameter
    if study.seed_parameter is not None:
        yield ("seed_parameter",), study.seed_parameter.node, study.seed_parameter.parameter


def problem(
    item: Parameter, known: Mapping[str, Described], leader: Parameter | None = None
) -> str:
    """Return in a line why a node will not take a parameter of a study; empty if it will.

    Parameters
    ----------
    item
        The parameter.
    known
        All parameters of the node.
    leader
        The parameter that it is tied to, from which it takes its values.
    """
    name = item.array or item.parameter
    described = known.get(name)
    if described is None:
        return _undeclared(name, known)
    if text := _unsettable(name, described, f"{item.type}_array" if item.array else item.type):
        return text
    if item.type not in ("double", "integer") or item.array:
        return ""
    source = item if leader is None else leader
    given = [*(source.bounds or ()), *_constants_of(source)]
    values = [float(value) for value in given]
    return _outside(values, name, described) or _off_steps(source, name, described)


def _unsettable(name: str, described: Described, expected: str) -> str:
    """Return in a line why a parameter takes no value of a type; empty if it does."""
    if described.read_only:
        return f"'{name}' is read-only in the node"
    if described.type not in ("", expected):
        return f"'{name}' is of type {described.type} in the node, not {expected}"
    return ""


def _constants_of(item: Parameter) -> tuple[Value, ...]:
    """Return the single values that a parameter may have: a fixed one, or its choices."""
    return (item.choices or ()) if item.fixed is None else (item.fixed,)


def _off_steps(item: Parameter, name: str, described: Described) -> str:
    """Return in a line that a study has values between a node's steps; empty if it has none."""
    if not described.step or not math.isfinite(described.lower):
        return ""

    def is_multiple(value: float) -> bool:
        steps = value / described.step
        return math.isclose(steps, round(steps), rel_tol=1e-9, abs_tol=1e-9)

    # A node takes the ends of a range even if they are between steps.
    values = map(float, _constants_of(item))
    offsets = [value - described.lower for value in values if value < described.upper]
    if item.bounds is not None:
        step = 1.0 if item.is_integer and item.step is None else item.step
        # A double of the study without a step can have any value.
        offsets += [item.bounds[0] - described.lower, math.nan if step is None else step]
    if all(math.isfinite(offset) and is_multiple(offset) for offset in offsets):
        return ""
    return (
        f"'{name}' goes in steps of {described.step:g} from {described.lower:g} on in the node; "
        "expected a lower bound and a step that are multiples of these"
    )


def _outside(values: Iterable[float], name: str, described: Described) -> str:
    """Return in a line which value a parameter's range does not have; empty if it has all."""
    for value in values:
        if not described.lower <= value <= described.upper:
            return (
                f"{value:g} lies outside the range of '{name}' in the node, "
                f"[{described.lower:g}, {described.upper:g}]"
            )
    return ""


def _integer_for_double(name: str, value: checks.ParameterValue, described: Described) -> str:
    """Return in a line that a constant is an integer where the node has a double; else empty.

    The node would refuse it, but only if its present value is another one.
    """
    items = value if isinstance(value, tuple) else (value,)
    if described.type not in ("double", "double_array") or type(items[0]) is not int:
        return ""
    doubles = [float(item) for item in items]
    expected = doubles if described.type == "double_array" else doubles[0]
    return f"'{name}' is of type {described.type} in the node; write {expected}"


def _undeclared(name: str, known: Mapping[str, Described]) -> str:
    """Return in a line that a node lacks a parameter, with names that it has."""
    return f"the node has no parameter '{name}'; {checks.suggestion(name, known)}"


def _parameters(mapping: object) -> dict[str, dict[str, object]]:
    section = mapping.get("parameters") if isinstance(mapping, dict) else None
    return section if isinstance(section, dict) else {}


def _node(mapping: object, node: object) -> dict[str, object]:
    nodes = mapping.get("nodes") if isinstance(mapping, dict) else None
    spec = nodes.get(node) if isinstance(nodes, dict) else None
    return spec if isinstance(spec, dict) else {}


def _constants(mapping: object, node: object) -> dict[str, object]:
    """Return the parameters that a study file sets once on a node."""
    constants = _node(mapping, node).get("parameters")
    return constants if isinstance(constants, dict) else {}


def _add_constant(mapping: object, node: str, name: str, value: object) -> None:
    spec = _node(mapping, node)
    spec["parameters"] = {**_constants(mapping, node), name: value}
