"""Hears all topics of a study's nodes, whatever they are: the graph tells names and types."""

import importlib
import threading
import time
from functools import partial
from typing import Any, Protocol

from rclpy.context import Context
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.task import Future

from bo_tuner.recording.bag import Topic, make_topic

NODE_NAME = "bo_tuner_recorder"
NOT_HEARD = ("/rosout",)
DEPTH = 2000
"""Messages of a topic that may wait; some cuts' worth, for a moment in which this process is
busy."""
SPIN_PERIOD = 0.1
SETTLE = 0.3
"""Time [s] in which the nodes' publishers find a new subscription, on one machine."""


class Sink(Protocol):
    """Where messages go; its methods are called in the listener's thread."""

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message."""

    def lose(self, count: int) -> None:
        """Take note of messages that the middleware has lost."""

    def warn(self, text: str) -> None:
        """Take note of a topic that cannot be heard."""


class TopicListener:
    """A ROS node with a subscription to each topic of some nodes, served by a thread.

    Messages are taken as they are on the wire, without being decoded.

    Parameters
    ----------
    context
        The ROS context of the tuner: one participant for both keeps the traffic low.
    nodes
        Names of the nodes to hear, relative to the namespace.
    sink
        Where messages go.
    """

    def __init__(self, context: Context, nodes: list[str], sink: Sink) -> None:
        self._nodes = nodes
        self._sink = sink
        self._heard: set[str] = set()
        self._node = Node(
            NODE_NAME, context=context, enable_rosout=False, start_parameter_services=False
        )
        # The other executor takes four times as long for a message.
        self._executor = EventsExecutor(context=context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="topic-listener", daemon=True)
        self._thread.start()
        while self.refresh():
            time.sleep(SETTLE)

    def refresh(self) -> bool:
        """Subscribe to topics that were not there before; returns whether there were any."""
        found: dict[str, str] = {}
        for node in self._nodes:
            path = node if node.startswith("/") else f"{self._node.get_namespace()}/{node}"
            namespace, _, name = path.rpartition("/")
            namespace = f"/{namespace.strip('/')}"
            # A node that is lost at the moment has no topics.
            try:
                topics = self._node.get_publisher_names_and_types_by_node(name, namespace)
                topics += self._node.get_subscriber_names_and_types_by_node(name, namespace)
            except RuntimeError:
                continue
            for topic, types in topics:
                found.setdefault(topic, types[0])
        new = found.keys() - self._heard - {*NOT_HEARD}
        for topic in sorted(new):
            self._heard.add(topic)
            self._subscribe(topic, found[topic])
        return bool(new)

    def close(self) -> None:
        """Stop listening."""
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()

    def _subscribe(self, name: str, message_type: str) -> None:
        try:
            topic = make_topic(name, message_type)
            message_class = _message_class(message_type)
        except (KeyError, ImportError, AttributeError):
            self._sink.warn(f"{name} is not recorded: its type {message_type} is not known here")
            return
        publishers = self._node.get_publishers_info_by_topic(name)
        best_effort = any(
            info.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT for info in publishers
        )
        qos = QoSProfile(
            depth=DEPTH,
            reliability=QoSReliabilityPolicy.BEST_EFFORT
            if best_effort
            else QoSReliabilityPolicy.RELIABLE,
        )
        self._node.create_subscription(
            message_class,
            name,
            partial(self._sink.take, topic),
            qos,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost),
            raw=True,
        )

    def _on_lost(self, info: QoSMessageLostInfo) -> None:
        self._sink.lose(info.total_count_change)

    def _spin(self) -> None:
        while not self._stop.is_set():
            # Returns after the period only: one call for many messages is a fifth cheaper.
            self._executor.spin_until_future_complete(Future(), SPIN_PERIOD)


def _message_class(name: str) -> Any:
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)
