"""Values of parameters, and the messages in which ROS has them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.parameter import Parameter, parameter_value_to_python

ARRAYS = (
    ParameterType.PARAMETER_BYTE_ARRAY,
    ParameterType.PARAMETER_BOOL_ARRAY,
    ParameterType.PARAMETER_INTEGER_ARRAY,
    ParameterType.PARAMETER_DOUBLE_ARRAY,
    ParameterType.PARAMETER_STRING_ARRAY,
)


@dataclass(frozen=True)
class UnknownType:
    """A parameter value of a type that ROS does not define; equal to none that can be set."""

    code: int

    def __str__(self) -> str:
        return f"of unknown type {self.code}"


def to_value(message: ParameterValue) -> object:
    """Read a parameter value; None if it is not set."""
    try:
        return parameter_value_to_python(message)
    except RuntimeError:
        return UnknownType(int(message.type))


def named_values(parameters: Iterable[ParameterMessage]) -> dict[str, object]:
    """Read messages of parameters, by name; None for those that are not set."""
    return {item.name: to_value(item.value) for item in parameters}


def to_messages(
    values: Mapping[str, object], types: Mapping[str, int] | None = None
) -> list[ParameterMessage]:
    """Make the messages that set parameters."""
    messages = []
    for name, value in values.items():
        kind = Parameter.Type.from_parameter_value(value)
        known = (types or {}).get(name)
        if value == [] and known in ARRAYS:
            kind = Parameter.Type(known)
        messages.append(Parameter(name, kind, value).to_parameter_msg())
    return messages
