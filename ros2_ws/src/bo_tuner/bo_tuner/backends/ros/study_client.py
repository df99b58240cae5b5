"""A client of a study's nodes: parameters and trigger by services, results by topics."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.parameters import (
    Difference,
    ParameterWatch,
    differences,
    read_values,
    to_messages,
)
from bo_tuner.backends.ros.results import RunResults
from bo_tuner.errors import BackendError
from bo_tuner.metrics.collect import STATUS_OK
from bo_tuner.study import checks
from bo_tuner.study.study import ReportedMetric, Study
from bo_tuner.study.study import Trigger as TriggerSpec

NODE_NAME = "bo_tuner"
RESULT_QOS = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.RELIABLE)
CALL_TIMEOUT = 5.0
ANSWER_TIMEOUT = 1.0
SPIN_PERIOD = 0.1

PARAMETER_EVENTS = "/parameter_events"

NAME_TIMEOUT = 1.0
"""Time [s] that the graph has to tell which node a new publisher belongs to."""
LONGEST_LEASE = 21.0
"""Time [s] after which a killed node is forgotten for sure, with Fast DDS as it is by default."""

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What the graph calls the node of a publisher that it has only just discovered."""


class LostError(Exception):
    """A node died, or is not there."""


class SilentError(LostError):
    """A node does not answer in time."""


class RefusedError(Exception):
    """A node refused its parameters, or did not take their values."""


class DisturbedError(Exception):
    """Somebody else has a hand in the evaluation, so that it is not what it was planned to be."""


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
        self._names: dict[str, list[str]] = {}
        self._publishers: dict[str, set[bytes]] = {}
        self._renewed: set[str] = set()
        self._anonymous: set[bytes] = set()
        self._twins: list[str] = []
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
            if not all(client.service_is_ready() for client, _ in self._parameter_calls(key))
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
            for client, request in self._parameter_calls(key):
                # A node that was killed looks discovered until its lease ends.
                while True:
                    try:
                        self._call(client, request, key, ANSWER_TIMEOUT)
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
        self._wait_for_names()
        found = []
        for key in self._study.nodes:
            present = self._publishers_of(key)
            # One that was killed stays in the graph for a while; what counts is what is new.
            if present - self._publishers.get(key, set()):
                found.append(key)
                self._renewed.add(key)
                self._known.pop(key, None)
            self._publishers[key] = present
        return found

    def twins(self, timeout: float) -> str:
        """Tell in a line of nodes that run more than once; empty if none does.

        A node that was killed and is back counts twice until its lease ends, which is waited for at
        most `timeout` seconds, and once only.
        """
        deadline = time.monotonic() + timeout
        while twins := self._repeated():
            if time.monotonic() > deadline or twins == self._twins:
                self._twins = twins
                return (
                    f"{twins[0]} runs more than once in ROS domain {self._context.get_domain_id()}"
                )
            self._spin()
        self._twins = []
        return ""

    def forget_parameters(self) -> None:
        """Forget what the nodes have, so that they are asked, and told, again."""
        self._known.clear()

    def assign(self, key: str, values: Mapping[str, object]) -> list[str]:
        """Set those parameters of a node that it does not have already, all of them or none.

        Returns
        -------
        list of str
            The names of those that were set.

        Raises
        ------
        RefusedError
            If the node refuses them.
        LostError
            If it does not answer.
        """
        if key not in self._known:
            self._known[key] = self.read(key)
        known = self._known[key]
        changes = {name: v for name, v in values.items() if _differs(known, name, v)}
        if not changes:
            return []
        request = SetParametersAtomically.Request(parameters=to_messages(changes))
        result = self._call(self._setters[key], request, key).result
        if not result.successful:
            raise RefusedError(f"{key} refused its parameters: {result.reason}")
        known.update(changes)
        # A node may take what it has not declared.
        self._names[key] += [name for name in changes if name not in self._names[key]]
        return list(changes)

    def assign_and_read_back(self, key: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node, which must then have these values.

        Raises
        ------
        RefusedError
            If the node refuses them, or has others then.
        LostError
            If it does not answer.
        """
        self.assign(key, values)
        self._known |= self._read([key])
        if wrong := differences(key, self._known[key], values):
            raise _not_taken(wrong[0])

    def read(self, key: str) -> dict[str, object]:
        """Read all parameters of a node.

        Raises
        ------
        LostError
            If it does not answer.
        """
        request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
        listed = self._call(self._listers[key], request, key).result.names
        self._names[key] = [name for name in listed if checks.PARAMETER_NAME.fullmatch(name)]
        return self._read([key])[key]

    def evaluate(
        self,
        wanted: Mapping[str, Mapping[str, object]],
        run: Callable[[], object] | None = None,
    ) -> dict[str, dict[str, object]]:
        """Set parameters, run an evaluation, and see that it ran with them.

        Parameters
        ----------
        wanted
            By node key the values that its parameters must have, whether the study sets them or
            not.
        run
            Runs once, in place of the trigger; then no node says anything.

        Returns
        -------
        dict
            By node key what the node said of the evaluation: of all nodes that give metrics, or
            fewer as soon as one says that it failed.

        Raises
        ------
        RefusedError
            If a node refuses its parameters, or has another value right after it was told one.
        DisturbedError
            If somebody else changed a parameter, a node runs more than once, or two of them report
            the same evaluation.
        LostError
            If a node does not answer, is started anew, or gives no result.
        """
        self.restarted()
        for key in self._renewed:
            self._known[key] = self.read(key)
            self._parameters.forget(key)
        self._renewed.clear()
        self._refuse_twins()
        self._parameters.expect(wanted)
        told = {key: self._tell(key, values) for key, values in wanted.items()}
        self._check(wanted, told)
        self.results.begin()
        try:
            said = self._run_cut() if run is None else {}
            if run is not None:
                run()
            anew = self.restarted()
            self._refuse_twins()
            if anew:
                name = self._study.nodes[anew[0]].node
                raise LostError(f"{name} was started anew in the evaluation")
            self._check(wanted, {})
            self._refuse_unreadable()
            if self.results.contradicted:
                raise DisturbedError(
                    f"{self.results.contradicted[0]}: two different results of one evaluation"
                )
            return said
        finally:
            self.results.end()

    def _tell(self, key: str, values: Mapping[str, object]) -> list[str]:
        before = dict(self._known.get(key, {}))
        try:
            return self.assign(key, values)
        except RefusedError:
            # What was changed by somebody else may be what the values do not go with.
            self._known[key] = self._read([key])[key]
            changed = differences(key, self._known[key], before) + self._parameters.take_seen()
            if changed:
                raise _disturbed(changed[0]) from None
            raise

    def _check(
        self, wanted: Mapping[str, Mapping[str, object]], told: Mapping[str, Sequence[str]]
    ) -> None:
        """Compare what the nodes have, and had since the last check, with what they should."""
        found = self._read(wanted)
        self._known |= found
        seen = self._parameters.take_seen()
        if self._parameters.problem:
            raise DisturbedError(self._parameters.problem)
        for key, values in wanted.items():
            for difference in differences(key, found[key], values):
                if difference.name in told.get(key, ()):
                    raise _not_taken(difference)
                raise _disturbed(difference)
        if seen:
            raise _disturbed(seen[0])

    def _refuse_unreadable(self) -> None:
        if self.results.problem:
            raise DisturbedError(self.results.problem)

    def _refuse_twins(self) -> None:
        if twins := self.twins(LONGEST_LEASE):
            raise DisturbedError(twins)

    def _read(self, keys: Iterable[str]) -> dict[str, dict[str, object]]:
        """Read the parameters of nodes side by side, by key."""
        calls = {
            key: self._getters[key].call_async(GetParameters.Request(names=self._names[key]))
            for key in keys
        }
        found = {}
        for key, future in calls.items():
            name = self._study.nodes[key].node
            values = self._await(self._getters[key], future, name, CALL_TIMEOUT).values
            if len(values) != len(self._names[key]):
                # A node leaves out all if it lacks one.
                values = [self._value(key, name) for name in self._names[key]]
            found[key] = read_values(self._names[key], values)
        return found

    def _value(self, key: str, name: str) -> ParameterValue:
        request = GetParameters.Request(names=[name])
        values = self._call(self._getters[key], request, key).values
        return values[0] if values else ParameterValue()

    def expect_answer(self, key: str, timeout: float = CALL_TIMEOUT) -> None:
        """Ask a node to change no parameter.

        Raises
        ------
        SilentError
            If it does not answer within `timeout` seconds.
        """
        self._call(self._setters[key], SetParametersAtomically.Request(), key, timeout)

    def _run_cut(self) -> dict[str, dict[str, object]]:
        """Start an evaluation and wait for its results."""
        trigger = self._study.trigger
        if trigger is None:
            raise BackendError("the study has no trigger")
        deadline = time.monotonic() + trigger.timeout
        self.results.identify(self._start_evaluation(trigger, deadline))
        return self._await_results(trigger, deadline)

    def _await_results(self, trigger: TriggerSpec, deadline: float) -> dict[str, dict[str, object]]:
        metrics = self._study.metrics.values()
        awaited = {trigger.node} | {m.node for m in metrics if isinstance(m, ReportedMetric)}
        while True:
            self._refuse_unreadable()
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
        self._listers: dict[str, Client] = {}
        nodes = {key: spec.node for key, spec in self._study.nodes.items()}
        self._parameters = ParameterWatch(self._node, nodes)
        for key, spec in self._study.nodes.items():
            self._setters[key] = self._node.create_client(
                SetParametersAtomically, f"{spec.node}/set_parameters_atomically"
            )
            self._getters[key] = self._node.create_client(
                GetParameters, f"{spec.node}/get_parameters"
            )
            self._listers[key] = self._node.create_client(
                ListParameters, f"{spec.node}/list_parameters"
            )
            if spec.result:
                topic = _of_node(spec.node, spec.result)
                self._node.create_subscription(
                    DiagnosticArray, topic, partial(self._on_result, key), RESULT_QOS, raw=True
                )
        trigger = self._study.trigger
        self._triggered = None if trigger is None else trigger.node
        if trigger is not None:
            self._trigger = self._node.create_client(
                Trigger, _of_node(self._study.nodes[trigger.node].node, trigger.service)
            )

    def _parameter_calls(self, key: str) -> list[tuple[Client, Any]]:
        """List the services of a node's parameters, each with a request that changes nothing."""
        return [
            (self._setters[key], SetParametersAtomically.Request()),
            (self._getters[key], GetParameters.Request()),
            (self._listers[key], ListParameters.Request()),
        ]

    def _repeated(self) -> list[str]:
        """Name the nodes and services that more than one process gives."""
        found = [
            spec.node
            for key, spec in self._study.nodes.items()
            if self._node.count_services(self._setters[key].srv_name) > 1
        ]
        if self._triggered and self._node.count_services(self._trigger.srv_name) > 1:
            found.append(self._trigger.srv_name)
        return found

    def _publishers_of(self, key: str) -> set[bytes]:
        """Find the publishers of a node's sign of life that the graph says are of the node."""
        name = expand_topic_name(self._study.nodes[key].node, NODE_NAME, self._node.get_namespace())
        infos = self._node.get_publishers_info_by_topic(self._sign_of_life(key))
        return {
            bytes(info.endpoint_gid)
            for info in infos
            if f"{info.node_namespace.rstrip('/')}/{info.node_name}" == name
        }

    def _wait_for_names(self) -> None:
        """Wait until the graph tells whose the new signs of life are."""
        deadline = time.monotonic() + NAME_TIMEOUT
        while nameless := self._nameless() - self._anonymous:
            if time.monotonic() > deadline:
                # Not of a ROS node, or else it is noticed once it has a name.
                self._anonymous |= nameless
                return
            self._spin()

    def _nameless(self) -> set[bytes]:
        topics = {self._sign_of_life(key) for key in self._study.nodes}
        infos = [i for topic in topics for i in self._node.get_publishers_info_by_topic(topic)]
        return {bytes(info.endpoint_gid) for info in infos if info.node_name == UNKNOWN_NODE}

    def _sign_of_life(self, key: str) -> str:
        """Topic on which a node has a publisher from its start on, and anew when it restarts."""
        spec = self._study.nodes[key]
        return _of_node(spec.node, spec.result) if spec.result else PARAMETER_EVENTS

    def _on_result(self, key: str, data: bytes) -> None:
        try:
            message = decode(data, DiagnosticArray)
        except UnreadableError as error:
            self.results.add_unreadable(f"{self._study.nodes[key].node}: a result {error}")
            return
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
        return self._await(client, client.call_async(request), name, timeout)

    def _await(self, client: Client, future: Future, name: str, timeout: float) -> Any:
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


def _of_node(node: str, name: str) -> str:
    """Expand ``~/name`` for a node other than this one."""
    return f"{node}/{name.removeprefix('~/')}" if name.startswith("~/") else name


def _differs(known: Mapping[str, object], name: str, value: object) -> bool:
    return name not in known or not checks.same_value(known[name], value)


def _not_taken(difference: Difference) -> RefusedError:
    return RefusedError(f"{difference} (not taken by the node)")


def _disturbed(difference: Difference) -> DisturbedError:
    return DisturbedError(f"{difference} (changed by someone else)")
