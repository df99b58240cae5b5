"""The clock of a run that plays a bag: the time of the bag, which the tuner publishes itself."""

import time
from bisect import bisect_right

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from bo_tuner.backends.ros.clock import TOPIC, to_stamp
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.tuner_node import TunerNode

DEPTH = 1000
"""Messages that may wait for a node."""


class PlayClock:
    """The time of the bag in a run; between two runs time passes as on the machine."""

    coarse = True

    def __init__(
        self, tuner: TunerNode, topics: dict[str, OwnTopic], listener: Node | None
    ) -> None:
        publisher = tuner.node.create_publisher(ClockMessage, TOPIC, DEPTH)
        # Others that publish it as well are found as those of every topic that a step publishes.
        self._topic = topics[TOPIC] = OwnTopic(publisher, ClockMessage, listener)
        self.start = 0
        """Time [ns] at which the next run begins."""
        self._received = [0]
        self._times = [0]
        self._ended = time.monotonic_ns()
        self._is_running = False

    @property
    def now(self) -> int:
        """The latest time [ns] of the bag, and what has passed since the end of a run."""
        passed = 0 if self._is_running else time.monotonic_ns() - self._ended
        return self._times[-1] + passed

    @property
    def steady(self) -> int:
        """The same: it goes back from one run to the next."""
        return self.now

    def begin(self) -> None:
        """Go back to where the bag begins."""
        self._received, self._times = [time.time_ns()], [self.start]
        self._is_running = True
        self._publish(self.start)

    def end(self) -> None:
        """Let time pass as on the machine."""
        self._is_running = False
        self._ended = time.monotonic_ns()

    def update(self) -> None:
        """Do nothing: `now` is always current."""

    def look(self) -> None:
        """Do nothing: it goes on as the bag is played, which is watched there."""

    def at(self, received: int) -> int:
        """Return the time [ns] that it was when a message was received."""
        return self._times[max(bisect_right(self._received, received) - 1, 0)]

    def tick(self, stamp: int) -> bool:
        """Go on to a time [ns], and publish it; returns whether it is a new one."""
        if stamp <= self._times[-1]:
            return False
        # In this order another thread finds a time for each entry.
        self._times.append(stamp)
        self._received.append(time.time_ns())
        self._publish(stamp)
        return True

    def _publish(self, stamp: int) -> None:
        self._topic.publish(ClockMessage(clock=to_stamp(stamp)))
