"""A topic that is heard: its messages one by one, decoded, each with who has published it."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.lost_messages import LostMessages
from bo_tuner.backends.ros.publishers import Publishers
from bo_tuner.backends.ros.taking import PublisherTaker, taker

DEPTH = 5000
"""Messages of a topic that may wait until they are taken: 5 s at 1 kHz."""


class Heard(NamedTuple):
    """A message: as it is on the wire, decoded, its time of reception [ns], and its node.

    The node is empty if that is not known.
    """

    data: bytes
    message: Any
    received: int
    node: str = ""


class HeardTopic:
    """Messages wait in the middleware, which notes when they came in, until they are taken.

    Attributes
    ----------
    problem : str
        In a line, what was wrong with a message that could not be read; whoever reports it empties
        it.
    knows_publisher : bool
        Whether the publisher of each message is known.
    unidentified : int
        Messages since `begin` with an unknown publisher.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        cls: Any,
        offered: Sequence[TopicEndpointInfo],
        knows_publisher: bool = False,
    ) -> None:
        self.name = name
        self.cls = cls
        self.publishers = Publishers(node, name)
        self.problem = ""
        qos = weakest([info.qos_profile for info in offered])
        self.is_latched = (
            qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
            and qos.reliability == QoSReliabilityPolicy.RELIABLE
        )
        # It is in no executor, which would call this.
        self.subscription = node.create_subscription(cls, name, lambda message: None, qos, raw=True)
        self._taker = taker(self.subscription, knows_publisher)
        self.knows_publisher = isinstance(self._taker, PublisherTaker)
        self.unidentified = 0
        self._lost: dict[bytes, LostMessages] = {}

    def take(self) -> Iterator[Heard]:
        """Take what waits; a message that cannot be read is left out, and noted in `problem`."""
        handle = self.subscription.handle
        with handle:
            count = handle.get_publisher_count()
            # No more than can wait: a topic that is faster than this loop always has another.
            for _ in range(DEPTH):
                taken = self._taker.take()
                if taken is None:
                    break
                # Each publisher counts its own messages.
                lost = self._lost.setdefault(taken.gid, LostMessages())
                lost.note(taken.number, 1 if taken.gid else count)
                try:
                    message = decode(taken.data, self.cls)
                except UnreadableError as error:
                    self.problem = f"a message on {self.name} {error}"
                    continue
                node = self.publishers.name_of(taken.gid)
                self.unidentified += not node
                yield Heard(taken.data, message, taken.received, node)

    def begin(self) -> None:
        """Count what is lost from now on."""
        self.problem = ""
        self.unidentified = 0
        for lost in self._lost.values():
            lost.count = 0

    def lost(self, node: str = "") -> int:
        """Return how many messages the middleware has lost, of those of a node or of all."""
        return sum(
            lost.count
            for gid, lost in self._lost.items()
            if not node or self.publishers.name_of(gid) == node
        )


def weakest(offered: Sequence[QoSProfile]) -> QoSProfile:
    """Return a quality of service that all publishers offer."""
    reliable = all(qos.reliability != QoSReliabilityPolicy.BEST_EFFORT for qos in offered)
    latched = all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
        ),
    )
