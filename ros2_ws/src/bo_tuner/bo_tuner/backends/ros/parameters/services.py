"""The parameters of one node, through its standard services."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter, parameter_value_to_python

from bo_tuner.backends.ros.errors import SilentError
from bo_tuner.backends.ros.tuner_node import Calls, TunerNode

NAMES = {
    SetParametersAtomically: "set_parameters_atomically",
    GetParameters: "get_parameters",
    ListParameters: "list_parameters",
    DescribeParameters: "describe_parameters",
}
ARRAYS = (
    ParameterType.PARAMETER_BYTE_ARRAY,
    ParameterType.PARAMETER_BOOL_ARRAY,
    ParameterType.PARAMETER_INTEGER_ARRAY,
    ParameterType.PARAMETER_DOUBLE_ARRAY,
    ParameterType.PARAMETER_STRING_ARRAY,
)
ATTEMPT = 1.0
"""Time [s] after which a request that changes nothing is repeated: a node that was killed looks
discovered until its lease ends, and one may receive a request before it has discovered who asks."""


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
    """Make the messages that set parameters.

    Parameters
    ----------
    values
        Values by name.
    types
        What `ParameterType` the node's own have, by name: an empty array tells of none.
    """
    messages = []
    for name, value in values.items():
        kind = Parameter.Type.from_parameter_value(value)
        known = (types or {}).get(name)
        if value == [] and known in ARRAYS:
            kind = Parameter.Type(known)
        messages.append(Parameter(name, kind, value).to_parameter_msg())
    return messages


class ParameterClient:
    """Calls the parameter services of a node.

    What gives `Calls` is for `TunerNode.complete`.

    Parameters
    ----------
    tuner
        The tuner's node.
    node
        Name of the other one, relative to the namespace.
    services
        Those that are used; that which sets parameters first, and one that reads after it.
    """

    def __init__(self, tuner: TunerNode, node: str, *services: Any) -> None:
        self.node = node
        self._tuner = tuner
        self._types: dict[str, int] = {}
        self._clients = {
            kind: tuner.node.create_client(kind, f"{node}/{NAMES[kind]}") for kind in services
        }

    def destroy(self) -> None:
        """Leave the services."""
        for client in self._clients.values():
            self._tuner.node.destroy_client(client)

    def is_ready(self) -> bool:
        """Whether all services are discovered."""
        return all(client.service_is_ready() for client in self._clients.values())

    def servers(self) -> int:
        """Count the nodes that answer under this name."""
        client = next(iter(self._clients.values()))
        return self._tuner.node.count_services(client.srv_name)

    def expect_answers(self, deadline: float) -> None:
        """Have the services that read answer, until a time of `monotonic`.

        One that answers a later client knows the earlier ones (see `meet`), and that which sets
        parameters is the first: to set none of them would call functions of the node's author
        with a list that is empty, which they need not expect.
        """
        for kind in self._clients:
            if kind is SetParametersAtomically:
                continue
            while True:
                try:
                    self._tuner.complete([self._calling(kind, kind.Request())], ATTEMPT)
                    break
                except SilentError:
                    if time.monotonic() > deadline:
                        raise

    def names(self) -> Calls:
        """List the parameters."""
        request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
        return list((yield from self._calling(ListParameters, request)).result.names)

    def descriptors(self, names: Sequence[str]) -> Calls:
        """Describe parameters."""
        request = DescribeParameters.Request(names=names)
        return list((yield from self._calling(DescribeParameters, request)).descriptors)

    def messages(self, names: Sequence[str]) -> Calls:
        """Read parameters as messages, not set where the node does not have one."""
        request = GetParameters.Request(names=names)
        found = list((yield from self._calling(GetParameters, request)).values)
        if len(found) == len(names):
            self._types |= {name: item.type for name, item in zip(names, found, strict=True)}
            return found
        if len(names) == 1:
            return [ParameterValue()]
        # A node may leave out all if it lacks one.
        found = []
        for name in names:
            found += yield from self.messages([name])
        return found

    def values(self, names: Sequence[str]) -> Calls:
        """Read parameters, by name; None where the node does not have one."""
        found = yield from self.messages(names)
        return dict(zip(names, map(to_value, found), strict=True))

    def set(self, values: Mapping[str, object]) -> Calls:
        """Set parameters, all of them or none; returns the result."""
        messages = to_messages(values, self._types)
        # A node may take them and not answer.
        self._types |= {item.name: item.value.type for item in messages}
        request = SetParametersAtomically.Request(parameters=messages)
        return (yield from self._calling(SetParametersAtomically, request)).result

    def _calling(self, kind: Any, request: Any) -> Calls:
        return self._tuner.calling(self._clients[kind], request, self.node)


def meet(tuner: TunerNode, node: str, deadline: float) -> None:
    """Wait until a node sends here all that this process has subscribed to so far.

    What it publishes before is lost, and that its publishers are known here does not tell. But it
    hears of the subscriptions in the order in which they were made, so one that answers a new
    client knows all earlier ones. One without parameter services is not waited for.

    Raises
    ------
    SilentError
        If it does not answer until `deadline`, a time of `monotonic`.
    """
    client = ParameterClient(tuner, node, GetParameters)
    try:
        if not client.servers():
            return
        tuner.wait_until(client.is_ready, deadline - time.monotonic())
        client.expect_answers(deadline)
    finally:
        client.destroy()
