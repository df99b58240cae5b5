"""The time by which references stream, for a thread of their own."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage

from bo_tuner.backends.ros.clock import TOPIC, RunClock
from bo_tuner.errors import StudyError

READING = 0.0005
"""Time [s] between two readings of a simulated clock: a callback for each message costs more
than that where there are a thousand in a second."""


class Ticks(Protocol):
    """Tells the time to threads."""

    def now(self) -> int:
        """Return the time [ns] since an arbitrary origin; it never goes back."""

    def stamp(self) -> int:
        """Return the time [ns] of the run's clock, for a header."""

    def wait_until(self, due: int, over: threading.Event) -> None:
        """Wait until a time of `now` [ns], or until `over` is set."""

    @property
    def remark(self) -> str:
        """What to know of the clock where a rate is not held; empty if nothing."""


class WallTicks:
    """The clock of this machine."""

    remark = ""

    def __init__(self, clock: RunClock) -> None:
        self._clock = clock

    def now(self) -> int:
        """Return the monotonic time [ns]."""
        return time.monotonic_ns()

    def stamp(self) -> int:
        """Return the time [ns] of the run's clock."""
        return self._clock.now

    def wait_until(self, due: int, over: threading.Event) -> None:
        """Wait until a time of `now` [ns], or until `over` is set."""
        if (left := due - time.monotonic_ns()) > 0:
            over.wait(left * 1e-9)


class SimTicks:
    """The clock of a simulation; where it is set back, time goes on from what it had come to."""

    def __init__(self, node: Node) -> None:
        # Only the latest time of a fast simulation matters.
        qos = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._subscription = node.create_subscription(ClockMessage, TOPIC, lambda m: None, qos)
        self._lock = threading.Lock()
        self._stamp: int | None = None
        self._passed = self._messages = 0

    def connect(self, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Wait for the first message; raises `StudyError` if there is none."""

        def has_time() -> bool:
            self.now()
            return self._stamp is not None

        if not wait(has_time):
            raise StudyError(f"no message on {TOPIC}; is the simulation paused?")

    def now(self) -> int:
        """Return the time [ns] that has passed by the clock."""
        handle = self._subscription.handle
        with self._lock, handle:
            while (item := handle.take_message(ClockMessage, False)) is not None:
                stamp = item[0].clock.sec * 1_000_000_000 + item[0].clock.nanosec
                if self._stamp is not None and stamp > self._stamp:
                    self._passed += stamp - self._stamp
                    self._messages += 1
                self._stamp = stamp
            return self._passed

    def stamp(self) -> int:
        """Return the latest time [ns]."""
        return self._stamp or 0

    def wait_until(self, due: int, over: threading.Event) -> None:
        """Wait until a time of `now` [ns], or until `over` is set."""
        while self.now() < due and not over.wait(READING):
            pass

    @property
    def remark(self) -> str:
        """The step of the clock from message to message, in words."""
        if not self._messages:
            return ""
        return f"; {TOPIC} goes on by about {self._passed / self._messages * 1e-9:.2g} s a message"
