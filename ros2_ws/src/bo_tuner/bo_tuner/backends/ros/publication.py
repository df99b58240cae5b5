"""A message for a topic, and whether those hear it who are to."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
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
from bo_tuner.backends.ros.number_writer import number_writer
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.tuner_node import TunerNode, full_name, is_own
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.fields import field_path
from bo_tuner.study.publishing import Topic
from bo_tuner.study.steps import Step
from bo_tuner.text import brief

CONNECT_TIMEOUT = 5.0
"""Time [s] to find a topic, or the subscribers of a message."""


class UnheardError(FailedRunError):
    """Nobody hears a message."""


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
    publish: Topic
    kind: Any
    clock: RunClock
    is_stop: bool

    @classmethod
    def prepare(
        cls,
        tuner: TunerNode,
        publish: Topic,
        clock: RunClock,
        topics: dict[str, OwnTopic],
        listener: Node | None,
        is_stop: bool,
    ) -> "Publication":
        """Find the subscribers and make the publisher, unless it is in `topics`."""
        node = tuner.node
        topic = node.resolve_topic_name(publish.topic)

        def of_type() -> list[TopicEndpointInfo]:
            infos = others.subscribers(node, topic)
            return [info for info in infos if publish.type in ("", info.topic_type)]

        heard = tuner.wait_until(lambda: bool(of_type()), CONNECT_TIMEOUT)
        if not heard and not others.subscribers(node, topic):
            near = others.instead(topic, others.topics(node), node)
            raise StudyError(f"nothing subscribes to {topic}; {near}", ("topic",))
        matching = of_type()
        types = sorted({info.topic_type for info in matching or others.subscribers(node, topic)})
        if not matching or len(types) > 1:
            expected = f"expected {publish.type}" if publish.type else "name one of them"
            raise StudyError(f"{topic} carries {' and '.join(types)}; {expected}", ("type",))
        with under("topic"):
            kind = interface_class(types[0])
        with under("message"):
            message = make_message(kind, publish.message)
        for name in publish.profile:
            with under("profile", name):
                number_writer(message, field_path(name))
        if topic not in topics:
            durability, depth = QoSDurabilityPolicy.VOLATILE, 10
            if any(
                i.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for i in matching
            ):
                # Who joins later is to hear the last message only, not what came before.
                durability, depth = QoSDurabilityPolicy.TRANSIENT_LOCAL, 1
            # In full, like the subscribers' in the graph: defaults cannot be compared with them.
            qos = QoSProfile(
                depth=depth,
                durability=durability,
                deadline=Infinite,
                liveliness=QoSLivelinessPolicy.AUTOMATIC,
                liveliness_lease_duration=Infinite,
            )
            topics[topic] = OwnTopic(node.create_publisher(kind, topic, qos), kind, listener)
        made = cls(tuner, topics[topic], publish, kind, clock, is_stop)
        if not tuner.wait_until(made._reaches_all, CONNECT_TIMEOUT) and not made.reaches_any():
            raise StudyError(made._unheard, ("topic",))
        return made

    def perform(self) -> None:
        """Publish it, once those who subscribe are connected: what comes earlier is lost."""
        is_heard = self.wait_until_heard()
        if is_heard or self.is_stop:
            self.publish_now()
        if not is_heard:
            raise self.unheard

    def filled(self, step: Step) -> "Publication":
        """Return the publication of a step's message."""
        if step.publish is None:
            return self
        (topic,) = step.publish.published
        with under("publish"):
            return self.of(topic)

    def of(self, topic: Topic) -> "Publication":
        """Return the publication of another message on its topic."""
        with under("message"):
            make_message(self.kind, topic.message)
        return replace(self, publish=topic)

    def wait_until_heard(self) -> bool:
        """Wait until those who subscribe are connected; whether anybody is."""
        connected = self.reaches_any if self.is_stop else self._reaches_all
        return self.tuner.wait_until(connected, CONNECT_TIMEOUT) or self.reaches_any()

    def publish_now(self) -> None:
        """Publish it for whoever is connected, with what profiles come to at their beginning."""
        message = make_message(self.kind, self.publish.message, to_stamp(self.clock.now))
        for name, profile in self.publish.profile.items():
            (value,) = profile.function("")(np.zeros(1))
            number_writer(message, field_path(name)).write(value)
        self.topic.publish(message)

    @property
    def unheard(self) -> UnheardError:
        """The error that nobody hears it."""
        return UnheardError(self._unheard)

    @property
    def _unheard(self) -> str:
        """Say that nobody hears it, and why a subscriber does not, if there is one."""
        for info in self._endpoints():
            if not is_own(info.node_name) and (reason := self._obstacle(info)):
                name = full_name(info.node_namespace, info.node_name)
                return f"{name} cannot hear what is published on {self.name}: {reason}"
        return f"nothing subscribes to {self.name}"

    @property
    def name(self) -> str:
        """Full name of the topic."""
        return str(self.topic.publisher.topic_name)

    def _endpoints(self) -> list[TopicEndpointInfo]:
        """Return the subscribers of the topic whose messages have this type."""
        endpoints = self.tuner.node.get_subscriptions_info_by_topic(self.name)
        return [info for info in endpoints if info.topic_type == type_name(self.kind)]

    def _obstacle(self, info: TopicEndpointInfo) -> str:
        """Return why a subscriber cannot hear the publisher by its QoS; empty if it can."""
        offered = self.topic.publisher.qos_profile
        compatible, reason = qos_check_compatible(offered, info.qos_profile)
        return brief(str(reason)) if compatible == QoSCompatibility.ERROR else ""

    def _subscribers(self) -> tuple[int, int]:
        """Count the subscribers that can hear the publisher: the tuner's own, and others."""
        hearing = [is_own(info.node_name) for info in self._endpoints() if not self._obstacle(info)]
        return hearing.count(True), hearing.count(False)

    def reaches_any(self) -> bool:
        """Whether a subscriber of others is connected."""
        own, _ = self._subscribers()
        return bool(self.topic.publisher.get_subscription_count() > own)

    def _reaches_all(self) -> bool:
        """Whether all subscribers of others are connected, and there are some."""
        own, others = self._subscribers()
        return others > 0 and bool(self.topic.publisher.get_subscription_count() >= own + others)
