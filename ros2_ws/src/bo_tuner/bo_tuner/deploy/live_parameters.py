"""Parameters of running nodes, through the standard services."""

import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor

from bo_tuner.backends.ros.isolation import DomainClaim
from bo_tuner.backends.ros.own_node import make_node
from bo_tuner.backends.ros.parameters import to_messages, to_value
from bo_tuner.deploy.apply import NodeError, RefusedError
from bo_tuner.errors import BackendError
from bo_tuner.text import brief

NODE_NAME = "bo_tuner_apply"
DISCOVERY_TIMEOUT = 10.0
CALL_TIMEOUT = 5.0
LOOK_AROUND = 1.0
"""Time [s] to discover a second node of a name."""
LEASE = 3.0
"""Time [s] after which the discovery profile has forgotten a killed node for sure."""
ATTEMPT = 1.0
"""Time [s] after which a request that changes nothing is repeated: a server may receive it before
it has discovered the client's response reader."""
SPIN_PERIOD = 0.1


class LiveParameters:
    """A ROS node that reads and sets the parameters of others; a context manager.

    Domain and discovery are those of the environment. Meanwhile no tuner on this machine uses the
    domain.

    Parameters
    ----------
    nodes
        Names of the nodes, relative to the namespace.
    ros_arguments
        ``--ros-args`` of this node.
    watch
        Called at least every `SPIN_PERIOD` seconds while waiting for the nodes; an exception ends
        the wait.

    Raises
    ------
    BackendError
        If ROS refuses the arguments, a tuner uses this domain, or a node is missing or runs more
        than once.
    """

    def __init__(
        self, nodes: list[str], ros_arguments: list[str], watch: Callable[[], None]
    ) -> None:
        self._claim: DomainClaim | None = None
        self._node = make_node(NODE_NAME, ros_arguments)
        self._context = self._node.context
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        try:
            self._claim = DomainClaim(self._node.get_namespace(), self._context.get_domain_id())
            self._getters = {
                node: self._node.create_client(GetParameters, f"{node}/get_parameters")
                for node in nodes
            }
            self._setters = {
                node: self._node.create_client(
                    SetParametersAtomically, f"{node}/set_parameters_atomically"
                )
                for node in nodes
            }
            self._wait_for_nodes(watch)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Destroy the node, shut down its context, and release the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
        if self._claim is not None:
            self._claim.release()

    def get(self, node: str, names: list[str]) -> dict[str, object]:
        """Read parameters of a node.

        Raises
        ------
        NodeError
            If the node does not answer, does not have one of them, or runs more than once.
        """
        self._refuse_twins(node)
        values = self._values(node, names)
        if len(values) != len(names) or None in values:
            # A node may return an empty list if a single parameter is missing.
            missing = [name for name in names if self._values(node, [name]) in ([], [None])]
            raise NodeError(f"{node}: has no parameter {' and no '.join(missing)}")
        return dict(zip(names, values, strict=True))

    def set(self, node: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node, all of them or none.

        Raises
        ------
        RefusedError
            If the node refuses them.
        NodeError
            If the node does not answer, or runs more than once; it may have set them.
        """
        self._refuse_twins(node)
        request = SetParametersAtomically.Request(parameters=to_messages(values))
        response = self._call(self._setters[node], request, CALL_TIMEOUT)
        if response is None:
            raise _silent(node, CALL_TIMEOUT)
        if not response.result.successful:
            reason = brief(str(response.result.reason)) or "no reason given"
            raise RefusedError(f"{node} refuses: {reason}")

    def _values(self, node: str, names: list[str]) -> list[object]:
        """Read parameters; None for one that is not set or not declared."""
        response = self._ask(node, self._getters[node], GetParameters.Request(names=names))
        return [to_value(value) for value in response.values]

    def _refuse_twins(self, node: str) -> None:
        """Refuse a node that runs more than once: who answers would not tell of the other."""
        if self._node.count_services(self._setters[node].srv_name) > 1:
            domain = self._context.get_domain_id()
            raise NodeError(f"{node} runs more than once in ROS domain {domain}; end all but one")

    def _wait_for_nodes(self, watch: Callable[[], None]) -> None:
        deadline = time.monotonic() + DISCOVERY_TIMEOUT
        for node, setter in self._setters.items():
            while not (setter.service_is_ready() and self._getters[node].service_is_ready()):
                if time.monotonic() > deadline:
                    raise BackendError(
                        f"{node}: no such node in ROS domain {self._context.get_domain_id()} "
                        f"after {DISCOVERY_TIMEOUT:g} s"
                    )
                watch()
                self._executor.spin_once(timeout_sec=SPIN_PERIOD)
            # A request that changes values is sent only once, so test the connection first.
            try:
                self._ask(node, setter, SetParametersAtomically.Request())
            except NodeError as error:
                raise BackendError(str(error)) from error
        self._wait_for_single_nodes(watch)

    def _wait_for_single_nodes(self, watch: Callable[[], None]) -> None:
        begin = time.monotonic()
        while True:
            watch()
            self._executor.spin_once(timeout_sec=SPIN_PERIOD)
            elapsed = time.monotonic() - begin
            try:
                for node in self._setters:
                    self._refuse_twins(node)
            except NodeError as error:
                # One that was killed and is back counts twice until its lease ends.
                if elapsed > LEASE:
                    raise BackendError(str(error)) from error
            else:
                if elapsed > LOOK_AROUND:
                    return

    def _ask(self, node: str, client: Client, request: Any) -> Any:
        for _ in range(round(CALL_TIMEOUT / ATTEMPT)):
            response = self._call(client, request, ATTEMPT)
            if response is not None:
                return response
        raise _silent(node, CALL_TIMEOUT)

    def _call(self, client: Client, request: Any, timeout: float) -> Any:
        future = client.call_async(request)
        deadline = time.monotonic() + timeout
        while not future.done():
            if time.monotonic() > deadline:
                client.remove_pending_request(future)
                return None
            self._executor.spin_once(timeout_sec=SPIN_PERIOD)
        return future.result()


def _silent(node: str, timeout: float) -> NodeError:
    return NodeError(f"{node}: does not answer within {timeout:g} s")
