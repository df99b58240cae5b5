"""The tuner's ROS node: it is served while the tuner waits, and calls services with a deadline."""

import contextlib
import re
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from bo_tuner.backends.ros.errors import SilentError
from bo_tuner.backends.ros.isolation import namespace_of
from bo_tuner.errors import BackendError

NODE_NAME = "bo_tuner"
LIVE_NODE = "tuner"
"""Name of the node that publishes a run in progress, and takes requests to pause and end it."""
NAMESPACE = re.compile(r"/|(/[A-Za-z_]\w*)+/?", re.ASCII)
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What the graph calls the node of a publisher that it has only just discovered."""
END_OTHERS = "end all but one (one that was killed counts for up to 20 s)"
CALL_TIMEOUT = 5.0
SPIN_PERIOD = 0.1
POLL_PERIOD = 0.01
"""Time [s] between two checks of a condition that is waited for."""
LOOK_AROUND = 1.0
"""Time [s] to discover a second node of a name."""


@dataclass(frozen=True)
class PendingCall:
    """A call of a service that may not be answered yet."""

    answer: Future
    node: str
    service: str
    begun: float
    """Time [s] of `time.monotonic` at which it was made."""

    def silence(self, timeout: float) -> SilentError:
        """Make the error that it was not answered within `timeout` seconds."""
        return silence(self.node, self.service, timeout)


Calls = Generator[PendingCall, None, Any]
"""Calls of services, one after the other, that `TunerNode.complete` goes on with at each answer.

Where one is not answered in time, `SilentError` is raised, which they may handle.
"""


def silence(node: str, service: str, timeout: float) -> SilentError:
    """Make the error that a service of a node did not answer within `timeout` seconds."""
    return SilentError(f"{node} does not answer {service} within {timeout:g} s")


def is_own(name: str) -> bool:
    """Whether a node of this name is one of a tuner's: they begin with the same word."""
    return name.startswith(NODE_NAME)


def full_name(namespace: str, name: str) -> str:
    """Return the name of a node with its namespace, unless it is in full already."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


class TunerNode:
    """The tuner's ROS node.

    Attributes
    ----------
    context : Context
        ROS context of the node.
    node : Node
        The node, which is served by `spin_once`.
    served : float
        Time [s] of `time.monotonic` at which that was last done.
    """

    def __init__(
        self,
        domain: int | None,
        ros_arguments: Sequence[str],
        watch: Callable[[], None],
        name: str = NODE_NAME,
    ) -> None:
        self._watch = watch
        self._period = SPIN_PERIOD
        self.served = time.monotonic()
        self.node = _make_node(name, ros_arguments, domain)
        self.context = self.node.context
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    @property
    def domain(self) -> int:
        """The ROS domain."""
        return self.context.get_domain_id()

    def refuse_other_tuner(self) -> None:
        """Refuse to work beside a tuner in this namespace, on whatever machine it runs."""
        namespace = self.node.get_namespace()
        count = self.node.get_node_names_and_namespaces().count((NODE_NAME, namespace))
        if count > (self.node.get_name() == NODE_NAME):
            raise BackendError(
                f"another tuner is running as {full_name(namespace, NODE_NAME)}; wait for it, or "
                "use another namespace or ROS_DOMAIN_ID"
            )

    def repeated(self, name: str) -> str:
        """Say that several nodes or services have a name."""
        return f"{name} runs more than once in ROS domain {self.domain}"

    def warn(self, text: str) -> None:
        """Say something on the log of the node."""
        self.node.get_logger().warning(text)

    @contextlib.contextmanager
    def watched_by(self, watch: Callable[[], None]) -> Iterator[None]:
        """Ask another function than `watch` within, for what must be done in any case."""
        watch, self._watch = self._watch, watch
        try:
            yield
        finally:
            self._watch = watch

    @contextlib.contextmanager
    def also_watched_by(self, watch: Callable[[], object]) -> Iterator[None]:
        """Ask another function besides `watch` within, at least every `POLL_PERIOD` seconds."""
        before, period = self._watch, self._period

        def both() -> None:
            before()
            watch()

        self._period = POLL_PERIOD
        try:
            with self.watched_by(both):
                yield
        finally:
            self._period = period

    def look(self) -> None:
        """Ask `watch` now, ahead of what does not wait for anything."""
        self._watch()

    def spin_once(self, period: float = SPIN_PERIOD) -> None:
        """Take one message or answer, if one comes within `period` seconds."""
        self.served = time.monotonic()
        self._watch()
        self._executor.spin_once(timeout_sec=min(period, self._period))

    def spin_for(self, period: float) -> None:
        """Take what comes within `period` seconds."""
        deadline = time.monotonic() + period
        while (left := deadline - time.monotonic()) > 0.0:
            self.spin_once(min(SPIN_PERIOD, left))

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until a condition holds; returns whether it did within `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin_once(POLL_PERIOD)
        return True

    def call(self, client: Client, request: Any, name: str, timeout: float | None = None) -> Any:
        """Call a service and return its answer; `name` is that of its node, for a complaint."""
        limit = CALL_TIMEOUT if timeout is None else timeout
        # A request to a server that was started anew and is not discovered yet would be lost.
        if not self.wait_until(client.service_is_ready, limit):
            raise silence(name, client.srv_name, limit)
        (answer,) = self.complete([self.calling(client, request, name)], timeout)
        return answer

    def calling(self, client: Client, request: Any, name: str) -> Calls:
        """Call a service, as one of `Calls`; returns its answer."""
        future = client.call_async(request)
        try:
            yield PendingCall(future, name, client.srv_name, time.monotonic())
            return future.result()
        finally:
            client.remove_pending_request(future)

    def complete(self, works: Sequence[Calls], timeout: float | None = None) -> list[Any]:
        """Let calls be made and answered side by side; returns what came of each."""
        begun = time.monotonic()
        results: list[Any] = [None] * len(works)
        pending: dict[int, PendingCall | None] = dict.fromkeys(range(len(works)))
        try:
            while True:
                for index, call in list(pending.items()):
                    try:
                        if call is None or call.answer.done():
                            pending[index] = next(works[index])
                            continue
                        since, limit = call.begun, CALL_TIMEOUT
                        if timeout is not None:
                            since, limit = begun, timeout
                        # A dead server counts as ready until its lease ends, and never answers.
                        if time.monotonic() > since + limit:
                            pending[index] = works[index].throw(call.silence(limit))
                    except StopIteration as end:
                        results[index] = end.value
                        del pending[index]
                if not pending:
                    return results
                self.spin_once()
        finally:
            for index in pending:
                works[index].close()


def _make_node(name: str, ros_arguments: Sequence[str], domain: int | None) -> Node:
    """Make a node with a context of its own."""
    namespace = namespace_of(list(ros_arguments))
    if not NAMESPACE.fullmatch(namespace):
        # rcl reports this in three lines, in terms of its own parser.
        raise BackendError(
            f"cannot use --ros-args: __ns:={namespace}: a namespace begins with a slash, "
            "such as /cell; letters, digits and _ follow, no digit first"
        )
    context = Context()
    try:
        rclpy.init(
            args=list(ros_arguments),
            context=context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        # It has no parameters to set, and rclpy's services for them can be made to raise.
        return Node(name, context=context, start_parameter_services=False)
    except (RuntimeError, ValueError) as error:
        context.try_shutdown()
        what = "--ros-args" if domain is not None else "--ros-args or ROS_DOMAIN_ID"
        # rcl adds where in its own sources it found the mistake.
        raise BackendError(f"cannot use {what}: {str(error).split(', at /')[0]}") from error
