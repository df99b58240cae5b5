"""Topics that the study's steps publish: what others say on one in a run is not of the study."""

import threading
import time
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, QoSReliabilityPolicy

from bo_tuner.backends.ros.tuner_node import UNKNOWN_NODE, full_name, is_own

DEPTH = 5000
"""Messages of a topic that may wait until they are taken."""
ROUNDING = 1_000
"""Time [ns] by which the middleware may round its stamps."""


class OwnTopic:
    """A topic that the tuner publishes, and listens to.

    The middleware stamps each message when it is published. A message is somebody else's if its
    stamp lies in no call of `publish`, or in one that has had its message. Threads may publish
    while another one takes what came in.
    """

    def __init__(self, publisher: Publisher, kind: Any, listener: Node | None) -> None:
        self.publisher = publisher
        self._kind = kind
        self._node = listener
        self._published: list[tuple[int, int]] = []
        self._foreign = 0
        # A message must not be taken before it is known as one's own.
        self._lock = threading.Lock()
        # What is latched was said before: this hears only what comes from now on, by any publisher.
        qos = QoSProfile(depth=DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._subscription = listener and listener.create_subscription(
            kind, publisher.topic_name, lambda message: None, qos, raw=True
        )

    def publish(self, message: Any) -> None:
        """Publish a message."""
        with self._lock:
            begun = time.time_ns()
            self.publisher.publish(message)
            if self._subscription is not None:
                self._published.append((begun - ROUNDING, time.time_ns() + ROUNDING))

    def begin(self) -> None:
        """Overlook what others have said up to now."""
        self.take()
        self._foreign = 0

    def take(self) -> None:
        """Take what came in."""
        if self._subscription is None:
            return
        handle = self._subscription.handle
        with self._lock, handle:
            for _ in range(DEPTH):
                item = handle.take_message(self._kind, True)
                if item is None:
                    break
                stamp = item[1]["source_timestamp"]
                own = [call for call in self._published if call[0] <= stamp <= call[1]]
                if own:
                    # Messages of one publisher come in order.
                    del self._published[: self._published.index(own[0]) + 1]
                else:
                    self._foreign += 1

    @property
    def foreign(self) -> str:
        """Return a line if others have published the topic since `begin`; empty if not."""
        if self._node is None or self._foreign == 0:
            return ""
        name = self.publisher.topic_name
        infos = self._node.get_publishers_info_by_topic(name)
        nodes = sorted(
            {
                full_name(info.node_namespace, info.node_name)
                for info in infos
                if info.node_name != UNKNOWN_NODE and not is_own(info.node_name)
            }
        )
        who = " and ".join(nodes) or "somebody else"
        return (
            f"{who} published on {name} in the run, too, which a step of the study publishes; "
            "end that, or take the step out of the study"
        )
