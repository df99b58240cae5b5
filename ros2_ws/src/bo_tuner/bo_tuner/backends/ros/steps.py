"""The steps of a run, found in the graph beforehand so that mistakes show before the first run."""

from dataclasses import dataclass, replace
from typing import Any, Protocol

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rclpy.client import Client
from rclpy.duration import Infinite
from rclpy.node import Node
from rclpy.qos import (
    QoSCompatibility,
    QoSDurabilityPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    qos_check_compatible,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.clock import RunClock, to_stamp
from bo_tuner.backends.ros.messages import interface_class, make_message, type_name
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.tuner_node import TunerNode, full_name, is_own
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.building import under
from bo_tuner.study.steps import Call, Lifecycle, Publish, Step
from bo_tuner.text import brief

CONNECT_TIMEOUT = 5.0
"""Time [s] to find a topic, a service, an action, or the subscribers of a message."""
UNDONE = {"deactivate": ("inactive", "unconfigured"), "cleanup": ("unconfigured",)}
"""States in which a transition that takes something back has nothing to do."""


class UnheardError(FailedRunError):
    """Nobody hears a message."""


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


def where(path: KeyPath) -> str:
    """Name a step by its path in the study."""
    section, phase, index = path
    return f"{section}.{phase}[{index}]"


@dataclass(frozen=True)
class ServiceCall:
    """A call of a service."""

    tuner: TunerNode
    service: Client
    kind: Any
    request: Any
    path: KeyPath
    timeout: float

    @classmethod
    def prepare(cls, tuner: TunerNode, call: Call, path: KeyPath) -> "ServiceCall":
        """Find the service, and make the request.

        Raises
        ------
        StudyError
            If there is no such service, or its requests do not have the fields.
        """
        kind, client = _service(tuner, call.service)
        with under("call", "request"):
            request = make_message(kind.Request, call.request)
        return cls(tuner, client, kind, request, path, call.timeout)

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
            self.service, self.request, f"the node that {where(self.path)} calls", self.timeout
        )
        if getattr(response, "success", True) is False:
            reason = brief(getattr(response, "message", "")) or "no reason given"
            raise FailedRunError(f"{self.service.srv_name} refused: {reason}")


@dataclass(frozen=True)
class Publication:
    """A message for a topic.

    Attributes
    ----------
    is_stop
        Whether it is to bring the machine to rest: it is published as soon as anybody hears it,
        and in the end also if nobody seems to.
    """

    tuner: TunerNode
    topic: OwnTopic
    publish: Publish
    kind: Any
    clock: RunClock
    is_stop: bool

    @classmethod
    def prepare(
        cls,
        tuner: TunerNode,
        publish: Publish,
        clock: RunClock,
        topics: dict[str, OwnTopic],
        listener: Node | None,
        is_stop: bool,
    ) -> "Publication":
        """Find the subscribers and make the publisher, unless it is in `topics`.

        Raises
        ------
        StudyError
            If nothing subscribes, or the messages do not have the fields.
        """
        node = tuner.node
        topic = node.resolve_topic_name(publish.topic)

        def subscribers() -> list[TopicEndpointInfo]:
            found = node.get_subscriptions_info_by_topic(topic)
            # The tuner's own nodes, which record the topic, do not count.
            return [info for info in found if not is_own(info.node_name)]

        def of_type() -> list[TopicEndpointInfo]:
            return [i for i in subscribers() if publish.type in ("", i.topic_type)]

        if not tuner.wait_until(lambda: bool(of_type()), CONNECT_TIMEOUT) and not subscribers():
            near = others.instead(topic, others.topics(node), node)
            raise StudyError(f"nothing subscribes to {topic}; {near}", ("publish", "topic"))
        found = of_type()
        types = sorted({info.topic_type for info in found or subscribers()})
        if not found or len(types) > 1:
            expected = f"expected {publish.type}" if publish.type else "name one of them"
            raise StudyError(
                f"{topic} carries {' and '.join(types)}; {expected}", ("publish", "type")
            )
        with under("publish", "topic"):
            kind = interface_class(types[0])
        with under("publish", "message"):
            make_message(kind, publish.message)
        if topic not in topics:
            durability, depth = QoSDurabilityPolicy.VOLATILE, 10
            if any(i.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for i in found):
                # Who joins later is to hear the last message only, not what came before.
                durability, depth = QoSDurabilityPolicy.TRANSIENT_LOCAL, 1
            # In full, as the graph tells those of subscribers: by default they do not compare.
            qos = QoSProfile(
                depth=depth,
                durability=durability,
                deadline=Infinite,
                liveliness=QoSLivelinessPolicy.AUTOMATIC,
                liveliness_lease_duration=Infinite,
            )
            topics[topic] = OwnTopic(node.create_publisher(kind, topic, qos), kind, listener)
        made = cls(tuner, topics[topic], publish, kind, clock, is_stop)
        if not tuner.wait_until(made._reaches_all, CONNECT_TIMEOUT) and not made._reaches_any():
            raise StudyError(made._unheard, ("publish", "topic"))
        return made

    def perform(self) -> None:
        """Publish it, once those who subscribe are connected: what comes earlier is lost."""
        connected = self._reaches_any if self.is_stop else self._reaches_all
        is_heard = self.tuner.wait_until(connected, CONNECT_TIMEOUT) or self._reaches_any()
        if is_heard or self.is_stop:
            self.publish_now()
        if not is_heard:
            raise UnheardError(self._unheard)

    def filled(self, step: Step) -> "Publication":
        """Return the publication of a step's message."""
        if step.publish is None:
            return self
        with under("publish", "message"):
            make_message(self.kind, step.publish.message)
        return replace(self, publish=step.publish)

    def publish_now(self) -> None:
        """Publish it for whoever is connected."""
        stamp = to_stamp(self.clock.now)
        self.topic.publish(make_message(self.kind, self.publish.message, stamp))

    @property
    def _unheard(self) -> str:
        """Tell that nobody hears it: why somebody who subscribes does not, if there is one."""
        for info in self._endpoints():
            if not is_own(info.node_name) and (reason := self._obstacle(info)):
                name = full_name(info.node_namespace, info.node_name)
                return f"{name} cannot hear what is published on {self._topic}: {reason}"
        return f"nothing subscribes to {self._topic}"

    @property
    def _topic(self) -> str:
        return str(self.topic.publisher.topic_name)

    def _endpoints(self) -> list[TopicEndpointInfo]:
        """Return the subscribers of the topic whose messages have this type."""
        found = self.tuner.node.get_subscriptions_info_by_topic(self._topic)
        return [info for info in found if info.topic_type == type_name(self.kind)]

    def _obstacle(self, info: TopicEndpointInfo) -> str:
        """Tell why a subscriber cannot hear the publisher by its QoS; empty if it can."""
        offered = self.topic.publisher.qos_profile
        compatible, reason = qos_check_compatible(offered, info.qos_profile)
        return brief(str(reason)) if compatible == QoSCompatibility.ERROR else ""

    def _subscribers(self) -> tuple[int, int]:
        """Count the subscribers that can hear the publisher: the tuner's own, and others."""
        hearing = [is_own(info.node_name) for info in self._endpoints() if not self._obstacle(info)]
        return hearing.count(True), hearing.count(False)

    def _reaches_any(self) -> bool:
        """Whether a subscriber of others is connected."""
        own, _ = self._subscribers()
        return bool(self.topic.publisher.get_subscription_count() > own)

    def _reaches_all(self) -> bool:
        """Whether all subscribers of others are connected, and there are some."""
        own, others = self._subscribers()
        return others > 0 and bool(self.topic.publisher.get_subscription_count() >= own + others)


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
        """Find the node.

        Raises
        ------
        StudyError
            If it is not there, or is no lifecycle node.
        """
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
        found = self._call(self.transitions, GetAvailableTransitions.Request())
        possible = {d.transition.label: d.transition for d in found.available_transitions}
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


def _service(tuner: TunerNode, service: str) -> tuple[Any, Client]:
    node = tuner.node
    name = node.resolve_service_name(service)
    if not tuner.wait_until(lambda: name in _services(tuner), CONNECT_TIMEOUT):
        near = others.instead(name, others.services(node), node)
        raise StudyError(f"there is no service {name}; {near}", ("call", "service"))
    with under("call", "service"):
        cls = interface_class(_services(tuner)[name][0])
    return cls, node.create_client(cls, name)


def _services(tuner: TunerNode) -> dict[str, list[str]]:
    """Return the types of services by name; the graph also tells those that only clients name."""
    found = tuner.node.get_service_names_and_types()
    return {name: types for name, types in found if tuner.node.count_services(name)}
