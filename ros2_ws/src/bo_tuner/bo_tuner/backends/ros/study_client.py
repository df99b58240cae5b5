"""A client of a study's nodes: parameters and trigger by services, results by topics."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import Trigger

from bo_tuner.backends.ros.results import RunResults
from bo_tuner.errors import BackendError
from bo_tuner.metrics.collect import STATUS_OK
from bo_tuner.study.study import ReportedMetric, Study
from bo_tuner.study.study import Trigger as TriggerSpec

NODE_NAME = "bo_tuner"
RESULT_QOS = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.RELIABLE)
CALL_TIMEOUT = 5.0
ANSWER_TIMEOUT = 1.0
SPIN_PERIOD = 0.1

PARAMETER_EVENTS = "/parameter_events"

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What the graph calls the node of a publisher that it has only just discovered."""


class LostError(Exception):
    """A node died, or is not there."""


class SilentError(LostError):
    """A node does not answer in time."""


class RefusedError(Exception):
    """A node refused its parameters."""


class StudyClient:
    """The tuner's ROS node, with a connection to each node of the study.

    Parameters
    ----------
    study
        The study.
    domain
        The ROS domain.
    ros_arguments
        ``--ros-args`` of the tuner's node.
    watch
        Called at least every `SPIN_PERIOD` seconds while waiting; raises what shall end the wait.

    Attributes
    ----------
    results
        What the nodes say of the present evaluation.

    Raises
    ------
    BackendError
        If ROS does not take the arguments.
    """

    def __init__(
        self, study: Study, domain: int, ros_arguments: list[str], watch: Callable[[], None]
    ) -> None:
        self._study = study
        self._watch = watch
        self._known: dict[str, dict[str, object]] = {}
        self._publishers: dict[str, set[bytes]] = {}
        self.results = RunResults()
        self._context = Context()
        try:
            rclpy.init(
                args=ros_arguments,
                context=self._context,
                domain_id=domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            # It has no parameters to set, and rclpy's services for them can be made to raise.
            self._node = Node(NODE_NAME, context=self._context, start_parameter_services=False)
        except (RuntimeError, ValueError) as error:
            self._context.try_shutdown()
            # rcl adds where in its own sources it found the mistake.
            raise BackendError(f"cannot use --ros-args: {str(error).split(', at /')[0]}") from error
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._connect()

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    @property
    def context(self) -> Context:
        """ROS context of the tuner's node."""
        return self._context

    def warn(self, text: str) -> None:
        """Say something on the log of the tuner's node."""
        self._node.get_logger().warning(text)

    @property
    def node(self) -> Node:
        """The tuner's node, which `spin_once` serves."""
        return self._node

    @property
    def full_name(self) -> str:
        """Name of the tuner's node, with its namespace."""
        return self._node.get_fully_qualified_name()

    def is_alone(self) -> bool:
        """Whether no other node has this one's name."""
        me = (self._node.get_name(), self._node.get_namespace())
        return self._node.get_node_names_and_namespaces().count(me) <= 1

    def absent(self) -> list[str]:
        """Return the study's keys of the nodes that are not discovered, or not in full."""
        return [
            key
            for key in self._study.nodes
            if not self._setters[key].service_is_ready()
            or self._node.count_publishers(self._sign_of_life(key)) == 0
            or (key == self._triggered and not self._trigger.service_is_ready())
        ]

    def spin_for(self, period: float) -> None:
        """Take what comes within `period` seconds."""
        deadline = time.monotonic() + period
        while time.monotonic() < deadline:
            self._spin()

    def wait_for_nodes(self, timeout: float) -> None:
        """Wait until every node is discovered and answers.

        Raises
        ------
        LostError
            If one does not within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        while absent := self.absent():
            if time.monotonic() > deadline:
                name = self._study.nodes[absent[0]].node
                domain = self._context.get_domain_id()
                raise LostError(f"{name}: no such node in ROS domain {domain} after {timeout:g} s")
            self._spin()
        for key in self._study.nodes:
            # A node that was killed looks discovered until its lease ends.
            while True:
                try:
                    self.expect_answer(key, ANSWER_TIMEOUT)
                    break
                except SilentError:
                    if time.monotonic() > deadline:
                        raise
        self.restarted()

    def wait_until_gone(self, timeout: float) -> None:
        """Wait until no node of the study is discovered any more, at most `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while len(self.absent()) < len(self._study.nodes) and time.monotonic() < deadline:
            self._spin()

    def restarted(self) -> list[str]:
        """Return the keys of nodes that were started anew since this was last asked.

        Such a node has forgotten its parameters, and is to be told them again.
        """
        found = []
        for key, spec in self._study.nodes.items():
            names = (spec.node.rpartition("/")[2], UNKNOWN_NODE)
            infos = self._node.get_publishers_info_by_topic(self._sign_of_life(key))
            if not spec.result:
                # The topic of every node: only where it is named it is known to be this one.
                path = self._node.resolve_service_name(spec.node)
                infos = [i for i in infos if _path(i) == path]
            present = {bytes(i.endpoint_gid) for i in infos if i.node_name in names}
            # One that was killed stays in the graph for a while; what counts is what is new.
            if present - self._publishers.get(key, set()):
                found.append(key)
                self._known.pop(key, None)
            self._publishers[key] = present
        return found

    def forget_parameters(self) -> None:
        """Forget what the nodes were told, so that they are told again."""
        self._known.clear()

    def set(self, key: str, values: Mapping[str, object]) -> None:
        """Set those parameters of a node that it was not told already, all of them or none.

        Raises
        ------
        RefusedError
            If the node refuses them.
        LostError
            If it does not answer.
        """
        known = self._known.setdefault(key, {})
        changes = {name: v for name, v in values.items() if known.get(name) != v}
        if not changes:
            return
        request = SetParametersAtomically.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in changes.items()]
        )
        result = self._call(self._setters[key], request, key).result
        if not result.successful:
            raise RefusedError(f"{key} refused its parameters: {result.reason}")
        known.update(changes)

    def get(self, key: str, names: Sequence[str]) -> dict[str, object]:
        """Read those parameters of a node that it has.

        Raises
        ------
        LostError
            If it does not answer.
        """
        request = GetParameters.Request(names=list(names))
        values = self._call(self._getters[key], request, key).values
        found = zip(names, map(parameter_value_to_python, values), strict=False)
        return {name: value for name, value in found if value is not None}

    def expect_answer(self, key: str, timeout: float = CALL_TIMEOUT) -> None:
        """Ask a node to change no parameter.

        Raises
        ------
        SilentError
            If it does not answer within `timeout` seconds.
        """
        self._call(self._setters[key], SetParametersAtomically.Request(), key, timeout)

    def run_cut(self) -> dict[str, dict[str, object]]:
        """Start an evaluation and wait for its results.

        Returns
        -------
        dict
            By node key what the node said of the evaluation: of all nodes that give metrics, or
            fewer as soon as one says that it failed.

        Raises
        ------
        LostError
            If the evaluation does not start, or a result does not come, within the trigger's
            timeout, or a node that has not said anything of a failed evaluation does not answer.
        """
        trigger = self._study.trigger
        if trigger is None:
            raise BackendError("the study has no trigger")
        deadline = time.monotonic() + trigger.timeout
        self.results.begin()
        try:
            self.results.identify(self._start_evaluation(trigger, deadline))
            return self._await_results(trigger, deadline)
        finally:
            self.results.end()

    def _await_results(self, trigger: TriggerSpec, deadline: float) -> dict[str, dict[str, object]]:
        metrics = self._study.metrics.values()
        awaited = {trigger.node} | {m.node for m in metrics if isinstance(m, ReportedMetric)}
        while True:
            said = self.results.said
            if any(pairs["status"] != STATUS_OK for pairs in said.values()):
                # A node may have failed the evaluation for want of another one.
                for key in sorted(awaited - said.keys()):
                    self.expect_answer(key)
                return said
            if awaited <= said.keys():
                return said
            if time.monotonic() > deadline:
                silent = ", ".join(sorted(awaited - said.keys()))
                raise SilentError(
                    f"no evaluation result from {silent} within {trigger.timeout:g} s"
                )
            self._spin()

    def _start_evaluation(self, trigger: TriggerSpec, deadline: float) -> str:
        while True:
            response = self._call(self._trigger, Trigger.Request(), trigger.node)
            if response.success:
                return str(response.message)
            # Right after the start the nodes may not have found each other yet.
            if time.monotonic() > deadline:
                name = self._study.nodes[trigger.node].node
                raise LostError(f"{name} does not start an evaluation: {response.message}")
            self._spin()

    def _connect(self) -> None:
        self._setters: dict[str, Client] = {}
        self._getters: dict[str, Client] = {}
        for key, spec in self._study.nodes.items():
            self._setters[key] = self._node.create_client(
                SetParametersAtomically, f"{spec.node}/set_parameters_atomically"
            )
            self._getters[key] = self._node.create_client(
                GetParameters, f"{spec.node}/get_parameters"
            )
            if spec.result:
                topic = _of_node(spec.node, spec.result)
                self._node.create_subscription(
                    DiagnosticArray, topic, partial(self._on_result, key), RESULT_QOS
                )
        trigger = self._study.trigger
        self._triggered = None if trigger is None else trigger.node
        if trigger is not None:
            self._trigger = self._node.create_client(
                Trigger, _of_node(self._study.nodes[trigger.node].node, trigger.service)
            )

    def _sign_of_life(self, key: str) -> str:
        """Topic on which a node has a publisher from its start on, and anew when it restarts."""
        spec = self._study.nodes[key]
        return _of_node(spec.node, spec.result) if spec.result else PARAMETER_EVENTS

    def _on_result(self, key: str, message: DiagnosticArray) -> None:
        for status in message.status:
            pairs: dict[str, object] = {item.key: item.value for item in status.values}
            failed = status.level == DiagnosticStatus.ERROR
            pairs.setdefault("status", "failed" if failed else STATUS_OK)
            pairs.setdefault("reason", status.message)
            self.results.add(key, pairs)

    def _call(self, client: Client, request: Any, key: str, timeout: float = CALL_TIMEOUT) -> Any:
        return self.call(client, request, self._study.nodes[key].node, timeout)

    def call(self, client: Client, request: Any, name: str, timeout: float = CALL_TIMEOUT) -> Any:
        """Call a service and return its answer; `name` is that of its node, for a complaint.

        Raises
        ------
        SilentError
            If it does not answer within `timeout` seconds.
        """
        future = client.call_async(request)
        deadline = time.monotonic() + timeout
        while not future.done():
            # A dead server looks ready until its lease ends, and the call would never return.
            if time.monotonic() > deadline:
                client.remove_pending_request(future)
                raise SilentError(f"{name} does not answer {client.srv_name} within {timeout:g} s")
            self._spin()
        return future.result()

    def spin_once(self, period: float) -> None:
        """Take one message or answer, if one comes within `period` seconds."""
        self._watch()
        self._executor.spin_once(timeout_sec=period)

    def _spin(self) -> None:
        self.spin_once(SPIN_PERIOD)


def _path(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def _of_node(node: str, name: str) -> str:
    """Expand ``~/name`` for a node other than this one."""
    return f"{node}/{name.removeprefix('~/')}" if name.startswith("~/") else name
