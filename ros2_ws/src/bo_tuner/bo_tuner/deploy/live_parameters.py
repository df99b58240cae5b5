"""Parameters of running nodes, through the standard services."""

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from rcl_interfaces.srv import GetParameters, SetParametersAtomically

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.errors import LostError, SilentError
from bo_tuner.backends.ros.errors import RefusedError as BackendRefusal
from bo_tuner.backends.ros.guard.link import GuardLink
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.isolation import LEASE, DomainClaim
from bo_tuner.backends.ros.parameters.events import ParameterWatch
from bo_tuner.backends.ros.parameters.messages import UnknownType
from bo_tuner.backends.ros.parameters.note import ParameterNote
from bo_tuner.backends.ros.parameters.services import ParameterClient
from bo_tuner.backends.ros.reconfiguration import Reconfiguration, reconfiguration_of
from bo_tuner.backends.ros.tuner_node import (
    CALL_TIMEOUT,
    END_OTHERS,
    LOOK_AROUND,
    TunerNode,
)
from bo_tuner.deploy.apply import NodeError, RefusedError
from bo_tuner.errors import BackendError, OutputError, StudyError
from bo_tuner.storage.parameter_file import NodeValues
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.study import Study
from bo_tuner.text import brief

NODE_NAME = "bo_tuner_apply"
DISCOVERY_TIMEOUT = 10.0
NONE: Mapping[str, NodeSpec] = {}
SETTLED = 2.0
"""Time [s] in which a node that was set new values shows whether it keeps them: one that judges
them in its own cycle, or gets others from a supervisor, does so within a period of these."""


class LiveParameters:
    """A ROS node that reads and sets the parameters of others.

    Domain and discovery are those of the environment. Meanwhile no tuner on this machine uses the
    domain; one on another machine is refused if it is there before.
    """

    def __init__(
        self,
        nodes: list[str],
        ros_arguments: list[str],
        watch: Callable[[], None],
        configured: Mapping[str, NodeSpec] = NONE,
    ) -> None:
        self._configured = configured
        self._ways: dict[str, tuple[Reconfiguration, str]] = {}
        self._claim: DomainClaim | None = None
        self._ros_arguments = ros_arguments
        self._tuner = TunerNode(None, ros_arguments, watch, NODE_NAME)
        try:
            self._claim = DomainClaim(self._tuner.node.get_namespace(), self._tuner.domain)
            self._clients = {
                node: ParameterClient(self._tuner, node, SetParametersAtomically, GetParameters)
                for node in nodes
            }
            self._events = ParameterWatch(self._tuner.node, {node: node for node in nodes})
            self._wait_for_nodes()
            self._tuner.refuse_other_tuner()
            self._note = ParameterNote(self._tuner.domain, self._tuner.node.get_namespace())
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the node, shut down its context, and release the domain."""
        self._tuner.close()
        if self._claim is not None:
            self._claim.release()

    def get(self, node: str, names: list[str]) -> dict[str, object]:
        """Read parameters of a node; raises `NodeError` if it runs more than once."""
        self._refuse_twins(node)
        try:
            (values,) = self._tuner.complete([self._clients[node].values(names)])
        except SilentError as error:
            raise NodeError(str(error)) from error
        if missing := [name for name, value in values.items() if value is None]:
            raise NodeError(f"{node}: has no parameter {' and no '.join(missing)}")
        for name, value in values.items():
            if isinstance(value, UnknownType):
                raise NodeError(f"{node}: {name} is {value}")
        return dict(values)

    def set(self, node: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node; raises `NodeError` if it runs more than once."""
        self._refuse_twins(node)
        try:
            (result,) = self._tuner.complete([self._clients[node].set(values)])
        except SilentError as error:
            raise NodeError(str(error)) from error
        if not result.successful:
            reason = brief(str(result.reason)) or "no reason given"
            raise RefusedError(f"{node} refuses: {reason}")

    def is_configured(self, node: str) -> bool:
        """Return whether a node takes its values only when it is configured."""
        return node in self._configured

    def configure(self, node: str) -> None:
        """Configure a node anew, so that it takes its values; raises `NodeError` if it does not."""
        try:
            way, state = self._way(node)
            way.configure_anew(state)
        except (LostError, BackendRefusal, StudyError) as error:
            raise NodeError(str(error)) from error

    def _way(self, node: str) -> tuple[Reconfiguration, str]:
        """Return how a node is configured, and the state in which it was at first."""
        if node not in self._ways:
            way = reconfiguration_of(self._tuner, self._configured[node])
            if way is None:
                raise StudyError(f"{node} has no lifecycle")
            self._ways[node] = way, way.state
        return self._ways[node]

    def take_remarks(self) -> list[str]:
        """Return lines, each of them once, on what nodes lack and what is done instead."""
        return [text for client in self._clients.values() for text in client.take_remarks()]

    def wait(self, period: float) -> None:
        """Wait for so many seconds."""
        self._tuner.spin_for(period)

    def undisturbed(self) -> contextlib.AbstractContextManager[None]:
        """Let nothing end a wait within."""
        return self._tuner.watched_by(lambda: None)

    def watch(self, values: NodeValues) -> None:
        """Watch for `SETTLED` seconds whether nodes keep values; raises `NodeError` if not."""
        self._events.expect(values)
        self._tuner.spin_for(SETTLED)
        if self._events.problem:
            raise NodeError(self._events.problem)
        if changed := self._events.take_seen():
            raise NodeError(f"{changed[0]} (it did not keep what it was set to)")

    @contextlib.contextmanager
    def guarded(self, study: Study, before: NodeValues, folder: Path) -> Iterator[None]:
        """Have a guard give nodes back what they had if this process ends within."""
        keys = {study.nodes[item.node].node: item.node for item in study.parameters_of_nodes}
        values = {keys[node]: of_node for node, of_node in before.items()}
        guard = GuardLink(self._tuner, Plan.of_values(study, values), folder)
        try:
            guard.begin(study, self._ros_arguments, values)
            yield
        finally:
            guard.end()

    def before_killed(self, node: str, values: Mapping[str, object]) -> dict[str, object]:
        """Return what a node had before a killed tuner, of what still has its values."""
        return self._note.left_behind(node, values)

    def forget_killed(self, node: str, names: Iterable[str]) -> None:
        """Let the next tuner take parameters for the node's own, whatever a killed run set."""
        self._note.forget(node, names)
        # At worst a later run sets back what it would leave.
        with contextlib.suppress(OutputError):
            self._note.write()

    def _refuse_twins(self, node: str) -> None:
        """Refuse a node that runs more than once, ahead of asking it for anything.

        The one that answers would not show the values of the other.
        """
        if self._clients[node].servers() > 1:
            raise RefusedError(f"{self._tuner.repeated(node)}; {END_OTHERS}")

    def _wait_for_nodes(self) -> None:
        def missing() -> list[str]:
            return [node for node, client in self._clients.items() if not client.is_ready()]

        if not self._tuner.wait_until(lambda: not missing(), DISCOVERY_TIMEOUT):
            raise BackendError(others.absent(missing(), self._tuner.node))
        # A request that changes values is sent only once, so test the connection first.
        for client in self._clients.values():
            try:
                client.expect_answers(time.monotonic() + CALL_TIMEOUT)
            except SilentError as error:
                raise BackendError(str(error)) from error
        self._wait_for_single_nodes()

    def _wait_for_single_nodes(self) -> None:
        begin = time.monotonic()
        while True:
            self._tuner.spin_once()
            elapsed = time.monotonic() - begin
            try:
                for node in self._clients:
                    self._refuse_twins(node)
            except NodeError as error:
                # One that was killed and is back counts twice until its lease ends.
                if elapsed > LEASE:
                    raise BackendError(str(error)) from error
            else:
                if elapsed > LOOK_AROUND:
                    return
