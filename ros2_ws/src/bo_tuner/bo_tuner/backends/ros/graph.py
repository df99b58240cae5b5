"""A look at running nodes: their parameters, and the topics of a study."""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.executors import SingleThreadedExecutor

from bo_tuner.backends.ros.clock import WallClock
from bo_tuner.backends.ros.own_node import make_node
from bo_tuner.backends.ros.parameters import to_value
from bo_tuner.backends.ros.preparation import run_problems
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study import checks
from bo_tuner.study.descriptors import Described
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study

NODE_NAME = "bo_tuner_look"
DISCOVERY = 5.0
"""Time [s] to find a node or a topic."""
ANSWER = 2.0
"""Time [s] for the answer of a node."""
PERIOD = 0.02
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


class Graph:
    """The graph in the domain and namespace of the environment and ``--ros-args``.

    Parameters
    ----------
    ros_arguments
        ``--ros-args`` of the node that looks.
    interrupted
        Asked while waiting; raises what shall end the wait.

    Attributes
    ----------
    node
        The node that looks.
    """

    def __init__(self, ros_arguments: Sequence[str], interrupted: Callable[[], None]) -> None:
        self._ros_arguments = ros_arguments
        self._interrupted = interrupted
        self.node = make_node(NODE_NAME, ros_arguments)
        self._context = self.node.context
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def describe(self, node: str) -> dict[str, Described]:
        """Return all parameters of a node, by name.

        Raises
        ------
        BackendError
            If it is not there, or does not answer.
        """
        with contextlib.ExitStack() as stack:
            clients = []
            for kind, service in (
                (ListParameters, "list_parameters"),
                (DescribeParameters, "describe_parameters"),
                (GetParameters, "get_parameters"),
            ):
                client = self.node.create_client(kind, f"{node}/{service}")
                stack.callback(self.node.destroy_client, client)
                clients.append(client)
            if not self.wait(lambda: all(client.service_is_ready() for client in clients)):
                near = checks.suggestion(node, self.node.get_node_names())
                raise BackendError(f"{node}: no such node; {near}")
            lister, describer, getter = clients
            request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
            names = list(self._call(lister, request, node).result.names)
            descriptors = self._call(describer, DescribeParameters.Request(names=names), node)
            values = self._call(getter, GetParameters.Request(names=names), node).values
        return {
            name: _described(descriptor, value)
            for name, descriptor, value in zip(names, descriptors.descriptors, values, strict=False)
        }

    def signal_problems(self, signals: Mapping[str, Signal]) -> Iterator[StudyError]:
        """Yield what is wrong with each signal, if anything."""
        for name, spec in signals.items():
            recorder = SignalRecorder(self._context, {name: spec})
            try:
                recorder.connect(WallClock(), self.wait)
            except StudyError as error:
                yield error
            finally:
                recorder.close()

    def run_problems(self, study: Study) -> Iterator[StudyError]:
        """Yield what is wrong with each step of a study's run, if anything."""
        tuner = TunerNode(
            self._context.get_domain_id(), list(self._ros_arguments), self._interrupted
        )
        try:
            yield from run_problems(study, tuner)
        finally:
            tuner.close()

    def wait(self, condition: Callable[[], bool], seconds: float = DISCOVERY) -> bool:
        """Wait until a condition holds, at most some seconds; whether it did."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._spin()
        return True

    def _call(self, client: Any, request: Any, node: str) -> Any:
        future = client.call_async(request)
        deadline = time.monotonic() + ANSWER
        while not future.done():
            if time.monotonic() > deadline:
                client.remove_pending_request(future)
                raise BackendError(f"{node} does not answer {client.srv_name} in {ANSWER:g} s")
            self._spin()
        return future.result()

    def _spin(self) -> None:
        self._interrupted()
        self._executor.spin_once(timeout_sec=PERIOD)


@contextlib.contextmanager
def opened_graph(
    ros_arguments: Sequence[str], interrupted: Callable[[], None] = lambda: None
) -> Iterator[Graph]:
    """Look at the graph in a ``with`` block."""
    graph = Graph(ros_arguments, interrupted)
    try:
        yield graph
    finally:
        graph.close()


def describe_nodes(
    nodes: Mapping[str, str],
    ros_arguments: Sequence[str],
    interrupted: Callable[[], None] = lambda: None,
) -> dict[str, dict[str, Described]]:
    """Return all parameters of nodes, ROS names by keys, as `Graph.describe`."""
    with opened_graph(ros_arguments, interrupted) as graph:
        return {key: graph.describe(name) for key, name in nodes.items()}


def _described(descriptor: ParameterDescriptor, value: Any) -> Described:
    kind = TYPES.get(value.type, "")
    found = to_value(value)
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    if not ranges:
        return Described(
            kind, found, read_only=descriptor.read_only, description=descriptor.description
        )
    (given,) = ranges[:1]
    return Described(
        kind,
        found,
        float(given.from_value),
        float(given.to_value),
        float(given.step),
        descriptor.read_only,
        descriptor.description,
    )
