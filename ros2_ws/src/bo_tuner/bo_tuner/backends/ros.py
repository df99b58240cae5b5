"""Cuts on ROS 2 nodes: parameters by services, the trigger by a service, metrics by topics."""

import os
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from bo_tuner.backends import Assignments
from bo_tuner.backends.collect import STATUS_OK, outcome
from bo_tuner.backends.isolation import DomainClaim, isolated_environment
from bo_tuner.backends.processes import NodeProcess
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study import Study
from bo_tuner.trials import CutOutcome, CutState

NODE_NAME = "bo_tuner"
RESULT_QOS = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.RELIABLE)
DISCOVERY_TIMEOUT = 20.0
ATTACH_TIMEOUT = 5.0
CALL_TIMEOUT = 5.0
SPIN_PERIOD = 0.1


class _Lost(Exception):
    """A node died or stays silent."""


class _Refused(Exception):
    """A node refused its parameters."""


class RosBackend:
    """Runs cuts on the study's nodes.

    Parameters
    ----------
    study
        The study.
    log_directory
        Takes what started nodes print.
    attach
        Use nodes that run already instead of starting them. They are looked for in the domain
        and with the discovery settings of the environment.
    ros_arguments
        ``--ros-args`` for the tuner's node and, as far as they are remappings of the namespace,
        for the nodes that it starts.
    interrupted
        Asked while waiting; raises what shall end the wait.
    """

    name = "ros"

    def __init__(
        self,
        study: Study,
        log_directory: Path,
        *,
        attach: bool = False,
        ros_arguments: list[str] | None = None,
        interrupted: Callable[[], None] = lambda: None,
    ) -> None:
        self._study = study
        self._log_directory = log_directory
        self._attach = attach
        self._ros_arguments = ros_arguments or []
        self._interrupted = interrupted
        self._claim: DomainClaim | None = None
        self._processes: dict[str, NodeProcess] = {}
        self._context: Context | None = None
        self._node: Node | None = None
        self._setters: dict[str, Client] = {}
        self._said: dict[str, dict[str, dict[str, object]]] = {}
        self._current: dict[str, dict[str, object]] = {}
        self.foreign_results = 0

    def open(self) -> None:
        """Start the nodes, unless attached, and wait until they are discovered.

        Raises
        ------
        BackendError
            If another tuner is at work on these nodes, a node cannot be started, or one does not
            appear in time.
        """
        given = os.environ.get("ROS_DOMAIN_ID")
        if given is not None and not (given.isascii() and given.isdigit() and int(given) <= 232):
            raise BackendError(f"ROS_DOMAIN_ID is {given!r}; expected a number from 0 to 232")
        wanted = int(given) if given is not None else (0 if self._attach else None)
        self._claim = DomainClaim(_namespace(self._ros_arguments), wanted)
        if not self._attach:
            isolation = isolated_environment(self._claim.domain)
            # The middleware reads the environment of the process, in this one too.
            os.environ.update({k: v for k, v in isolation.items() if k not in os.environ})
        os.environ.setdefault("ROS_LOG_DIR", str(self._log_directory))
        self._context = Context()
        try:
            rclpy.init(
                args=self._ros_arguments,
                context=self._context,
                domain_id=self._claim.domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
        except RuntimeError as error:
            raise BackendError(str(error).splitlines()[0]) from error
        self._node = Node(NODE_NAME, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._connect(self._node)
        if not self._attach:
            self._start_processes()
        self._wait_for_nodes(ATTACH_TIMEOUT if self._attach else DISCOVERY_TIMEOUT)
        self._refuse_second_tuner(self._node)
        self._set_constants()

    def run_cut(self, assignments: Assignments) -> CutOutcome:
        """Set parameters, run one cut, and collect its metrics.

        After a lost cut the nodes are started anew, or, attached, waited for.
        """
        try:
            for key, values in assignments.items():
                self._set(key, values)
            return outcome(self._study, self._cut())
        except _Refused as refusal:
            return CutOutcome(CutState.FAILED, {}, str(refusal))
        except _Lost as loss:
            self._recover()
            return CutOutcome(CutState.LOST, {}, str(loss))

    def close(self) -> None:
        """End the started nodes and leave ROS."""
        for process in self._processes.values():
            process.stop()
        self._processes.clear()
        if self._node is not None:
            self._executor.shutdown()
            self._node.destroy_node()
            self._node = None
        if self._context is not None:
            self._context.try_shutdown()
            self._context = None
        if self._claim is not None:
            self._claim.release()
            self._claim = None

    def _connect(self, node: Node) -> None:
        for key, spec in self._study.nodes.items():
            self._setters[key] = node.create_client(
                SetParametersAtomically, f"{spec.node}/set_parameters_atomically"
            )
            node.create_subscription(
                DiagnosticArray,
                _of_node(spec.node, spec.result),
                partial(self._on_result, key),
                RESULT_QOS,
            )
        trigger = self._study.trigger
        self._trigger = node.create_client(
            Trigger, _of_node(self._study.nodes[trigger.node].node, trigger.service)
        )

    def _on_result(self, key: str, message: DiagnosticArray) -> None:
        for status in message.status:
            pairs: dict[str, object] = {item.key: item.value for item in status.values}
            if "cut" not in pairs:
                self.foreign_results += 1
                continue
            failed = status.level == DiagnosticStatus.ERROR
            pairs.setdefault("status", "failed" if failed else STATUS_OK)
            pairs.setdefault("reason", status.message)
            self._said.setdefault(str(pairs["cut"]), {})[key] = pairs

    def _start_processes(self) -> None:
        environment = {
            # A node computes small matrices: more threads would only get in each other's way.
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "ROS_LOG_DIR": str(self._log_directory),
        }
        namespace = _namespace(self._ros_arguments)
        for key, spec in self._study.nodes.items():
            if not (spec.package and spec.executable):
                raise StudyError(
                    "no package and executable; add them, or use --attach", ("nodes", key)
                )
            arguments = ["--ros-args", "-r", f"__ns:={namespace}"]
            self._processes[key] = NodeProcess(
                spec.package,
                spec.executable,
                arguments,
                environment,
                self._log_directory / f"{key}.log",
            )

    def _wait_for_nodes(self, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while True:
            missing = self._missing_node()
            if missing is None:
                return
            for process in self._processes.values():
                if process.exit_reason is not None:
                    raise BackendError(process.exit_reason)
            if time.monotonic() > deadline:
                hint = "start it, or leave out --attach" if self._attach else "see its log"
                domain = self._claim.domain if self._claim else 0
                raise BackendError(
                    f"{missing}: no such node in ROS domain {domain} after {timeout:g} s; {hint}"
                )
            self._spin()

    def _missing_node(self) -> str | None:
        if self._node is None:
            raise BackendError("the backend is not open")
        for key, spec in self._study.nodes.items():
            topic = _of_node(spec.node, spec.result)
            if not self._setters[key].service_is_ready() or not self._node.count_publishers(topic):
                return spec.node
        if not self._trigger.service_is_ready():
            return self._study.nodes[self._study.trigger.node].node
        return None

    def _refuse_second_tuner(self, node: Node) -> None:
        me = (NODE_NAME, node.get_namespace())
        if node.get_node_names_and_namespaces().count(me) > 1:
            raise BackendError(
                f"another tuner is at work in namespace {node.get_namespace()}; wait for it, or "
                "use another namespace or ROS_DOMAIN_ID"
            )

    def _set_constants(self) -> None:
        for key, spec in self._study.nodes.items():
            try:
                self._set(key, spec.parameters)
            except _Refused as refusal:
                raise StudyError(str(refusal), ("nodes", key, "parameters")) from refusal
            except _Lost as loss:
                raise BackendError(str(loss)) from loss

    def _set(self, key: str, values: Mapping[str, object]) -> None:
        known = self._current.setdefault(key, {})
        changes = {name: v for name, v in values.items() if known.get(name) != v}
        if not changes:
            return
        request = SetParametersAtomically.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in changes.items()]
        )
        result = self._call(self._setters[key], request, self._study.nodes[key].node).result
        if not result.successful:
            raise _Refused(f"{key} refused its parameters: {result.reason}")
        known.update(changes)

    def _cut(self) -> dict[str, dict[str, object]]:
        self._said.clear()
        trigger = self._study.trigger
        name = self._study.nodes[trigger.node].node
        deadline = time.monotonic() + trigger.timeout
        response = self._call(self._trigger, Trigger.Request(), name)
        while not response.success:
            # Right after the start the nodes may not have found each other yet.
            if time.monotonic() > deadline:
                raise _Lost(f"{name} does not start a cut: {response.message}")
            self._spin()
            response = self._call(self._trigger, Trigger.Request(), name)
        awaited = {trigger.node} | {metric.node for metric in self._study.metrics.values()}
        while True:
            said = self._said.get(response.message, {})
            if any(pairs["status"] != STATUS_OK for pairs in said.values()):
                return said
            if awaited <= said.keys():
                return said
            self._check_alive()
            if time.monotonic() > deadline:
                silent = ", ".join(sorted(awaited - said.keys()))
                raise _Lost(f"no cut result from {silent} within {trigger.timeout:g} s")
            self._spin()

    def _call(self, client: Client, request: Any, node: str) -> Any:
        future = client.call_async(request)
        deadline = time.monotonic() + CALL_TIMEOUT
        while not future.done():
            # A dead server looks ready until its lease ends, and the call would never return.
            self._check_alive()
            if time.monotonic() > deadline:
                client.remove_pending_request(future)
                raise _Lost(f"{node} does not answer {client.srv_name} within {CALL_TIMEOUT:g} s")
            self._spin()
        return future.result()

    def _check_alive(self) -> None:
        for process in self._processes.values():
            if process.exit_reason is not None:
                raise _Lost(process.exit_reason)

    def _spin(self) -> None:
        self._interrupted()
        self._executor.spin_once(timeout_sec=SPIN_PERIOD)

    def _recover(self) -> None:
        self._current.clear()
        for process in self._processes.values():
            process.stop()
        try:
            if not self._attach:
                self._start_processes()
            self._wait_for_nodes(DISCOVERY_TIMEOUT)
            self._set_constants()
        except BackendError as error:
            # The next cut will find the same and be lost in turn; three lost trials end the run.
            if self._node is not None:
                self._node.get_logger().error(str(error))


def _namespace(ros_arguments: list[str]) -> str:
    for argument in reversed(ros_arguments):
        if argument.startswith("__ns:="):
            return argument.removeprefix("__ns:=")
    return "/"


def _of_node(node: str, name: str) -> str:
    """Expand ``~/name`` for a node other than this one."""
    return f"{node}/{name.removeprefix('~/')}" if name.startswith("~/") else name
