"""Queries of running nodes: their parameters, and the signals of a study."""

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import WallClock
from bo_tuner.backends.ros.errors import SilentError
from bo_tuner.backends.ros.isolation import LEASE, DomainClaim
from bo_tuner.backends.ros.parameters.messages import to_value
from bo_tuner.backends.ros.parameters.note import ParameterNote, said_of_killed
from bo_tuner.backends.ros.parameters.services import ParameterClient
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.backends.ros.tuner_node import END_OTHERS, LOOK_AROUND, TunerNode
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.descriptors import Described
from bo_tuner.study.signals import Signal
from bo_tuner.text import brief

NODE_NAME = "bo_tuner_look"
DISCOVERY = 5.0
"""Time [s] to find a node or a topic."""
FIRST_LOOK = 3.0
"""Time [s] to find out whether a node runs at all, which may not."""
ANSWER = 2.0
"""Time [s] for the answer of a node."""
LARGEST = (1e30, 2.0**62)
"""Ends of a range of doubles, and of integers, from which on it is open."""
TYPES = {
    ParameterType.PARAMETER_BOOL: "boolean",
    ParameterType.PARAMETER_INTEGER: "integer",
    ParameterType.PARAMETER_DOUBLE: "double",
    ParameterType.PARAMETER_STRING: "string",
    ParameterType.PARAMETER_BOOL_ARRAY: "boolean_array",
    ParameterType.PARAMETER_INTEGER_ARRAY: "integer_array",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double_array",
    ParameterType.PARAMETER_STRING_ARRAY: "string_array",
}


@contextlib.contextmanager
def opened_node(
    ros_arguments: Sequence[str], interrupted: Callable[[], None]
) -> Iterator[TunerNode]:
    """Open a node for queries, in domain and namespace of the environment and ``--ros-args``."""
    tuner = TunerNode(None, ros_arguments, interrupted, NODE_NAME)
    try:
        claim = DomainClaim(tuner.node.get_namespace(), tuner.domain)
        try:
            tuner.spin_for(LOOK_AROUND)
            tuner.refuse_other_tuner()
            yield tuner
        finally:
            claim.release()
    finally:
        tuner.close()


def any_runs(
    names: Sequence[str], ros_arguments: Sequence[str], interrupted: Callable[[], None]
) -> bool:
    """Return whether one of some nodes runs, whoever else is at work there."""
    tuner = TunerNode(None, ros_arguments, interrupted, NODE_NAME)
    try:
        return tuner.wait_until(lambda: bool(others.running(names, tuner.node)), FIRST_LOOK)
    finally:
        tuner.close()


def describe(tuner: TunerNode, node: str, own: Iterable[str] = ()) -> dict[str, Described]:
    """Return all parameters of a node, by name, for a tuner that has set none of them yet.

    Those that a killed tuner has left on it have the values from before. Arguments and errors are
    those of `describe_now`.
    """
    described = describe_now(tuner, node, own)
    note = ParameterNote(tuner.domain, tuner.node.get_namespace())
    left = note.left_behind(node, {name: item.value for name, item in described.items()})
    for name, value in left.items():
        of_killed = said_of_killed(node, name, described[name].value)
        tuner.warn(f"{of_killed}; its own is taken to be {brief(str(value))}, as before")
        described[name] = replace(described[name], value=value)
    return described


def describe_now(tuner: TunerNode, node: str, own: Iterable[str] = ()) -> dict[str, Described]:
    """Return all parameters of a node, by name, as they are."""
    client = ParameterClient(tuner, node, ListParameters, DescribeParameters, GetParameters)
    try:
        if not tuner.wait_until(client.is_ready, DISCOVERY):
            raise BackendError(others.absent([node], tuner.node))
        # One that was killed is in the graph until its lease has ended.
        if not tuner.wait_until(lambda: client.servers() <= 1, LEASE):
            raise BackendError(f"{tuner.repeated(node)}; {END_OTHERS}")
        client.expect_answers(time.monotonic() + ANSWER)
        lists = client.offers(ListParameters)
        (names,) = tuner.complete([client.names()])
        if not lists:
            names = list(own)
            if not names:
                raise BackendError(f"{node}: lists no parameters (no service list_parameters)")
        # A node with one that is not set may be asked for each of hundreds.
        asked = [client.descriptors(names), client.messages(names)]
        descriptors, values = tuner.complete(asked)
    except SilentError as error:
        raise BackendError(str(error)) from error
    finally:
        client.destroy()
    return {
        name: _described(descriptor, value)
        for name, descriptor, value in zip(names, descriptors, values, strict=True)
        if lists or value.type != ParameterType.PARAMETER_NOT_SET
    }


def values_now(tuner: TunerNode, node: str, names: Sequence[str]) -> dict[str, object]:
    """Read parameters of a node that was just described."""
    client = ParameterClient(tuner, node)
    try:
        tuner.wait_until(client.is_ready, ANSWER)
        (values,) = tuner.complete([client.values(names)], ANSWER)
        return dict(values)
    except SilentError as error:
        raise BackendError(str(error)) from error
    finally:
        client.destroy()


def describe_nodes(
    nodes: Mapping[str, str], ros_arguments: Sequence[str], interrupted: Callable[[], None]
) -> dict[str, dict[str, Described]]:
    """Return all parameters of nodes, ROS names by keys, for a tuner that has set none yet."""
    with opened_node(ros_arguments, interrupted) as tuner:
        return {key: describe(tuner, name) for key, name in nodes.items()}


def signal_problems(tuner: TunerNode, signals: Mapping[str, Signal]) -> Iterator[StudyError]:
    """Yield what is wrong with each signal, if anything."""
    for name, spec in signals.items():
        recorder = SignalRecorder(tuner.context, {name: spec})
        try:
            recorder.connect(WallClock(), partial(tuner.wait_until, timeout=DISCOVERY))
        except StudyError as error:
            yield error
        finally:
            recorder.close()


def _described(descriptor: ParameterDescriptor, value: Any) -> Described:
    kind = TYPES.get(value.type, "")
    current = to_value(value)
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    if not ranges:
        return Described(
            kind, current, read_only=descriptor.read_only, description=descriptor.description
        )
    (given,) = ranges[:1]
    lower, upper = float(given.from_value), float(given.to_value)
    # A range has two ends. Of a limit on one side alone, the other is the largest number that
    # there is: nobody means to try it.
    return Described(
        kind,
        current,
        -math.inf if lower <= -LARGEST[kind == "integer"] else lower,
        math.inf if upper >= LARGEST[kind == "integer"] else upper,
        float(given.step),
        descriptor.read_only,
        descriptor.description,
    )
