"""The steps of a run, resolved in the graph beforehand: mistakes show before the first run."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.client import Client

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.answers import check_expected, refusal
from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.messages import interface_class, make_message
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import KeyPath, StudyError, dotted
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.steps import Call, Lifecycle, SetParameter, Step

CONNECT_TIMEOUT = 5.0
"""Time [s] to find a topic, a service or an action."""
UNDONE = {"deactivate": ("inactive", "unconfigured"), "cleanup": ("unconfigured",)}
"""States in which a transition that takes something back has nothing to do."""


class PreparedStep(Protocol):
    """A step, ready to be performed."""

    def perform(self) -> None:
        """Perform it.

        Raises
        ------
        FailedRunError
            If it is refused.
        LostError
            If a node does not answer.
        """

    def filled(self, step: Step) -> "PreparedStep":
        """Return the same step with other values of contexts.

        Raises
        ------
        StudyError
            If it cannot send them.
        """


@dataclass(frozen=True)
class ServiceCall:
    """A call of a service."""

    tuner: TunerNode
    service: Client
    kind: Any
    request: Any
    path: KeyPath
    timeout: float
    expected: Mapping[str, object]

    @classmethod
    def prepare(cls, tuner: TunerNode, call: Call, path: KeyPath) -> "ServiceCall":
        """Find the service, and make the request."""
        with under("call", "service"):
            kind, client = service_at(tuner, call.service)
        with under("call", "request"):
            request = make_message(kind.Request, call.request)
        with under("call", "expect"):
            check_expected(kind.Response, call.expect)
        return cls(tuner, client, kind, request, path, call.timeout, call.expect)

    def filled(self, step: Step) -> "ServiceCall":
        """Return the call with the request of a step."""
        if step.call is None:
            return self
        with under("call", "request"):
            request = make_message(self.kind.Request, step.call.request)
        return replace(self, request=request)

    def perform(self) -> None:
        """Call it."""
        response = self.tuner.call(
            self.service, self.request, f"the node that {dotted(self.path)} calls", self.timeout
        )
        if reason := refusal(response, self.expected):
            raise FailedRunError(f"{self.service.srv_name} refused: {reason}")


@dataclass(frozen=True)
class ParameterChange:
    """A parameter that is set in a run."""

    parameters: NodeParameters
    spec: SetParameter
    path: KeyPath

    def perform(self) -> None:
        """Set it, and read it back."""
        try:
            self.parameters.change(self.spec.node, {self.spec.parameter: self.spec.value})
        except RefusedError as refusal:
            raise FailedRunError(f"{dotted(self.path)}: {refusal}") from refusal

    def filled(self, step: Step) -> "ParameterChange":
        """Return the change of a step's value."""
        return self if step.set is None else replace(self, spec=step.set)


@dataclass(frozen=True)
class LifecycleChange:
    """A transition of a lifecycle node."""

    tuner: TunerNode
    spec: Lifecycle
    change: Client
    state: Client
    transitions: Client

    @classmethod
    def prepare(cls, tuner: TunerNode, spec: Lifecycle) -> "LifecycleChange":
        """Find the node."""
        clients = [
            tuner.node.create_client(kind, f"{spec.node}/{name}")
            for kind, name in (
                (ChangeState, "change_state"),
                (GetState, "get_state"),
                (GetAvailableTransitions, "get_available_transitions"),
            )
        ]

        def ready() -> bool:
            return all(client.service_is_ready() for client in clients)

        if not tuner.wait_until(ready, CONNECT_TIMEOUT):
            ends = "/change_state"
            names = [
                name.removesuffix(ends)
                for name in others.services(tuner.node)
                if name.endswith(ends)
            ]
            near = others.instead(spec.node, names, tuner.node)
            raise StudyError(
                f"there is no lifecycle node {spec.node}; {near}", ("lifecycle", "node")
            )
        return cls(tuner, spec, *clients)

    def filled(self, step: Step) -> "LifecycleChange":
        """Return the same: a transition has no context."""
        return self

    @property
    def current_state(self) -> str:
        """State of the node, such as ``active``; raises `LostError` if it does not answer."""
        return str(self._call(self.state, GetState.Request()).current_state.label)

    def perform(self) -> None:
        """Change the state.

        A transition that the node does not have in its state ends a node of rclpy: it is not asked
        for one.
        """
        spec, name = self.spec, self.spec.node
        state = self.current_state
        answer = self._call(self.transitions, GetAvailableTransitions.Request())
        possible = {d.transition.label: d.transition for d in answer.available_transitions}
        if spec.transition not in possible:
            if state in UNDONE.get(spec.transition, ()):
                return
            raise FailedRunError(
                f"{name} cannot {spec.transition}: it is {state}, "
                f"and can {', '.join(possible) or 'nothing'}"
            )
        request = ChangeState.Request(transition=possible[spec.transition])
        if not self._call(self.change, request).success:
            raise FailedRunError(f"{name} refused to {spec.transition}; it was {state}")

    def _call(self, client: Client, request: Any) -> Any:
        return self.tuner.call(client, request, self.spec.node, self.spec.timeout)


def service_at(tuner: TunerNode, service: str) -> tuple[Any, Client]:
    """Return the type of a service and a client; raises `StudyError` if there is none."""
    node = tuner.node
    name = node.resolve_service_name(service)
    if not tuner.wait_until(lambda: name in _services(tuner), CONNECT_TIMEOUT):
        near = others.instead(name, others.services(node), node)
        raise StudyError(f"there is no service {name}; {near}")
    cls = interface_class(_services(tuner)[name][0])
    return cls, node.create_client(cls, name)


def _services(tuner: TunerNode) -> dict[str, list[str]]:
    """Return the types of services by name, without those that only clients name."""
    services = tuner.node.get_service_names_and_types()
    return {name: types for name, types in services if tuner.node.count_services(name)}
