"""A node's ROS parameters, kept in step with a checked settings object."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter

from feed_axis_common.errors import SettingsError
from feed_axis_common.parameters import Specification, build, specifications

T = TypeVar("T")

LONGEST_REASON = 1000
KNOWN_TYPES = frozenset(kind.value for kind in Parameter.Type)
ROS_OWN_PARAMETERS = ("use_sim_time", "start_type_description_service")


class Refusal(ParameterNotDeclaredException):
    """Why a change is refused.

    rclpy's parameter services answer with the text of this kind of exception alone; any other
    ends the node and leaves the client without an answer.
    """

    def __init__(self, reason: str) -> None:
        # The name of an unknown parameter may be anything.
        Exception.__init__(self, " ".join(reason.split())[:LONGEST_REASON])


def descriptor(spec: Specification) -> ParameterDescriptor:
    """Describe a parameter to ROS: text, unit and range from its line of the table."""
    result = ParameterDescriptor(name=spec.name, description=spec.description)
    if spec.choices:
        result.additional_constraints = f"one of {', '.join(spec.choices)}"
    if spec.lower is not None and spec.upper is not None:
        if spec.kind is int:
            result.integer_range = [
                IntegerRange(from_value=int(spec.lower), to_value=int(spec.upper), step=0)
            ]
        elif spec.kind is float:
            result.floating_point_range = [
                FloatingPointRange(
                    from_value=float(spec.lower), to_value=float(spec.upper), step=0.0
                )
            ]
    return result


class NodeParameters(Generic[T]):
    """Declares a parameter table on a node and checks each change as a whole.

    The node must be made with ``automatically_declare_parameters_from_overrides=True``, so that
    values from the command line or a file are checked even if they are not in the table. A whole
    number is accepted for a double, on the command line and by ``ros2 param set`` alike.
    `settings` always holds the last accepted set.

    Parameters
    ----------
    node
        The node.
    table
        Dataclass made with `feed_axis_common.parameters.parameter`.
    defaults
        A value for each parameter.

    Raises
    ------
    SettingsError
        If a value given at the start breaks a rule.
    """

    def __init__(
        self,
        node: Node,
        table: type[T],
        defaults: Mapping[str, object],
    ) -> None:
        self._node = node
        self._table = table
        self._specs = {spec.name: spec for spec in specifications(table)}
        given = {
            name: _plain(node.get_parameter(name))
            for name in node.list_parameters([], 0).names
            if name not in ROS_OWN_PARAMETERS and not name.startswith("qos_overrides.")
        }
        self.settings: T = build(table, dict(defaults) | given)
        for name in given:
            node.undeclare_parameter(name)
        for name, value in asdict(self.settings).items():  # type: ignore[call-overload]
            value = list(value) if isinstance(value, tuple) else value
            node.declare_parameter(name, value, descriptor(self._specs[name]), ignore_override=True)
        for service in node.services:
            if service.srv_type in (SetParameters, SetParametersAtomically):
                service.callback = _refusing_unknown_types(service.callback)
        # Checked ahead of rclpy, whose own reasons name neither the parameter nor its value.
        node.add_pre_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, changes: list[Parameter]) -> list[Parameter]:
        try:
            changes = [self._cast(p) for p in changes]
            self._candidate(changes)
        except SettingsError as error:
            raise Refusal(str(error)) from None
        except Exception as error:
            raise Refusal(f"could not be checked: {error!r}") from error
        return changes

    def _cast(self, p: Parameter) -> Parameter:
        kind = self._specs[p.name].kind if p.name in self._specs else None
        if kind is float and p.type_ is Parameter.Type.INTEGER:
            return Parameter(p.name, Parameter.Type.DOUBLE, float(p.value))
        if kind is tuple and p.type_ is Parameter.Type.INTEGER_ARRAY:
            return Parameter(p.name, Parameter.Type.DOUBLE_ARRAY, [float(x) for x in p.value])
        return p

    def _apply(self, changes: list[Parameter]) -> None:
        self.settings = self._candidate(changes)

    def _candidate(self, changes: list[Parameter]) -> T:
        current: dict[str, object] = asdict(self.settings)  # type: ignore[call-overload]
        for p in changes:
            if p.name not in self._specs and self._node.has_parameter(p.name):
                continue  # one of rclpy's own
            if p.type_ is Parameter.Type.NOT_SET:
                raise SettingsError(f"{p.name}: cannot be deleted")
            current[p.name] = _plain(p)
        return build(self._table, current)


def _refusing_unknown_types(callback: Callable) -> Callable:
    """Refuse a value whose type does not exist; rclpy would end the node."""

    def guarded(request: Any, response: Any) -> Any:
        for p in request.parameters:
            if p.value.type not in KNOWN_TYPES:
                refusal = SetParametersResult(
                    successful=False, reason=f"{p.name}: unknown parameter type {p.value.type}"
                )
                if isinstance(response, SetParameters.Response):
                    response.results = [refusal] * len(request.parameters)
                else:
                    response.result = refusal
                return response
        return callback(request, response)

    return guarded


def _plain(p: Parameter) -> object:
    return p.value if isinstance(p.value, bool | int | float | str) else list(p.value or ())
