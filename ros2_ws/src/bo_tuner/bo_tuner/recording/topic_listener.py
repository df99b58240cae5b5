"""Hears all topics of a study's nodes and of its signals: the graph has names and types."""

import threading
import time
from dataclasses import dataclass, field
from typing import Protocol

from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.lost_messages import LostMessages
from bo_tuner.backends.ros.messages import interface_class
from bo_tuner.errors import StudyError
from bo_tuner.recording.bag import Topic, make_topic

NODE_NAME = "bo_tuner_recorder"
NOT_HEARD = ("/rosout",)
DEPTH = 2000
"""Messages of a topic that may wait; some evaluations' worth, for a moment in which this process is
busy."""
PERIOD = 0.1
"""Time [s] after which waiting messages are taken. To wake up for each of them would cost a loop
that runs beside it on few cores a multiple of this."""
SETTLE = 0.3
"""Time [s] in which the nodes' publishers find a new subscription, on one machine."""


class Sink(Protocol):
    """Where messages go; its methods are called from any thread."""

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message."""

    def lose(self, count: int) -> None:
        """Take note of messages that the middleware has lost."""

    def warn(self, text: str) -> None:
        """Take note of a topic that cannot be heard."""


class TopicListener:
    """A ROS node with a subscription to each topic of some nodes, served by a thread.

    Messages are taken as they are on the wire, without being decoded.
    """

    def __init__(self, context: Context, nodes: list[str], topics: list[str], sink: Sink) -> None:
        self._nodes = nodes
        self._topics = topics
        self._sink = sink
        self._heard: set[str] = set()
        self._node = Node(
            NODE_NAME, context=context, enable_rosout=False, start_parameter_services=False
        )
        self._subscriptions: list[_Heard] = []
        self._taking = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="topic-listener", daemon=True)
        self._thread.start()
        while self.refresh():
            time.sleep(SETTLE)

    def refresh(self) -> bool:
        """Subscribe to topics that were not there before; returns whether there were any."""
        types_of: dict[str, str] = {}
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
                types_of.setdefault(topic, types[0])
        known = dict(self._node.get_topic_names_and_types())
        for topic in map(self._node.resolve_topic_name, self._topics):
            if topic in known:
                types_of.setdefault(topic, known[topic][0])
        new = types_of.keys() - self._heard - {*NOT_HEARD}
        for topic in sorted(new):
            self._heard.add(topic)
            self._subscribe(topic, types_of[topic])
        return bool(new)

    def take(self) -> None:
        """Hand over all messages that wait, in the order in which they came."""
        with self._taking:
            waiting = [item for heard in self._subscriptions for item in heard.take()]
            for _, topic, data in sorted(waiting, key=lambda item: item[0]):
                self._sink.take(topic, data)
            lost = sum(heard.lost.count for heard in self._subscriptions)
            if lost:
                self._sink.lose(lost)
                for heard in self._subscriptions:
                    heard.lost.count = 0

    def close(self) -> None:
        """Hand over what waits, and stop listening."""
        self._stop.set()
        self._thread.join()
        self.take()
        self._node.destroy_node()

    def _subscribe(self, name: str, message_type: str) -> None:
        try:
            topic = make_topic(name, message_type)
            message_class = interface_class(message_type)
        except (KeyError, StudyError):
            # Of hidden topics, such as those of each action, nobody expects to find them.
            if not topic_or_service_is_hidden(name):
                self._sink.warn(
                    f"{name} is not recorded: its type {message_type} is not known here"
                )
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
        # It is in no executor, which would call this.
        subscription = self._node.create_subscription(
            message_class, name, lambda message: None, qos, raw=True
        )
        with self._taking:
            self._subscriptions.append(_Heard(topic, subscription))

    def _run(self) -> None:
        while not self._stop.wait(PERIOD):
            self.take()


def listen_to(backend: RosBackend, sink: Sink) -> TopicListener:
    """Return a listener to the nodes of an open backend, which know its subscriptions by now."""
    listener = TopicListener(backend.context, backend.nodes, backend.topics, sink)
    try:
        backend.meet_nodes()
    except BaseException:
        listener.close()
        raise
    return listener


@dataclass
class _Heard:
    """A subscription, and how many of its messages the middleware has lost."""

    topic: Topic
    subscription: Subscription
    lost: LostMessages = field(default_factory=LostMessages)

    def take(self) -> list[tuple[int, Topic, bytes]]:
        """Take the messages that wait, with the time of their arrival [ns]."""
        taken = []
        handle = self.subscription.handle
        with handle:
            # Another may have joined, or left, since the subscription was made.
            publishers = handle.get_publisher_count()
            while (item := handle.take_message(self.subscription.msg_type, True)) is not None:
                data, info = item
                taken.append((info["received_timestamp"], self.topic, data))
                self.lost.note(info["publication_sequence_number"], publishers)
        return taken
