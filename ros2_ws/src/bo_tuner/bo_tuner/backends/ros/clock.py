"""The clock of a run: that of this machine, or ``/clock`` of a simulation."""

import time
from bisect import bisect_right
from collections.abc import Callable
from typing import Protocol

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage

from bo_tuner.backends.ros.errors import DisturbedError, LostError
from bo_tuner.errors import BackendError, StudyError

TOPIC = "/clock"
LARGEST_JUMP = 0.5
"""Difference [s] of the machine's clock and a steady one in a run that is no slow correction."""
UNWATCHED = 1.0
"""Time [s] without a check after which what a clock did before is forgotten."""
LONGEST_STANDSTILL = 5.0
"""Time [s] of the machine after which a simulated clock that does not go on stands still."""
END_OF_TIME = 2**31 - 1
"""Latest time [s] in a ROS message, in January 2038."""
MARGIN = 86_400.0
"""Time [s] before that for an evaluation."""
DEPTH = 5000
"""Messages of /clock that may wait."""


class RunClock(Protocol):
    """Tells the time of a run in ns."""

    coarse: bool
    """Whether it goes on by steps that are longer than the distance of messages may be."""

    @property
    def now(self) -> int:
        """The time [ns]."""

    @property
    def steady(self) -> int:
        """Monotonic time [ns] from an arbitrary origin; nobody sets it, as far as possible."""

    def begin(self) -> None:
        """Start a run: from now on the clock must neither jump nor stand still."""

    def end(self) -> None:
        """End the run: the clock may be set."""

    def update(self) -> None:
        """Bring `now` up to date, where the clock was not read for a while."""

    def look(self) -> None:
        """Check the clock: `update`, and refuse one that a run cannot go by.

        Raises
        ------
        LostError
            If it stands still.
        DisturbedError
            If it jumped in a run.
        """

    def at(self, received: int) -> int:
        """Return the time [ns] of the run for the machine's at which a message was received."""


class WallClock:
    """The clock of this machine; within a run it goes on steadily."""

    coarse = False

    def __init__(self) -> None:
        self._is_running = False

    @property
    def now(self) -> int:
        """The time since the epoch [ns]."""
        if not self._is_running:
            return time.time_ns()
        return self._began + self.steady - self._began_steady

    @property
    def steady(self) -> int:
        """Monotonic time [ns] from an arbitrary origin."""
        return time.monotonic_ns()

    def begin(self) -> None:
        """Start a run."""
        self._began, self._began_steady = time.time_ns(), self.steady
        self._is_running = True

    def end(self) -> None:
        """End the run."""
        self._is_running = False

    def update(self) -> None:
        """Do nothing: `now` is always current."""

    def look(self) -> None:
        """Refuse a clock that was set in a run."""
        jump = (time.time_ns() - self.now) * 1e-9
        if abs(jump) > LARGEST_JUMP:
            raise DisturbedError(f"the clock of this machine jumped by {jump:+.3g} s in the run")

    def at(self, received: int) -> int:
        """Return `received`."""
        return received


class SimClock:
    """The time that a simulation publishes on /clock."""

    coarse = True

    def __init__(self, node: Node) -> None:
        self._node = node
        qos = QoSProfile(depth=DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._subscription = node.create_subscription(ClockMessage, TOPIC, lambda m: None, qos)
        self._received: list[int] = []
        self._times: list[int] = []
        self._is_running = False
        self._advanced = self._checked = time.monotonic()

    def connect(self, wait: Callable[[Callable[[], bool]], bool]) -> None:
        """Wait for the first message."""
        if not wait(lambda: bool(self._node.get_publishers_info_by_topic(TOPIC))):
            raise StudyError(f"nothing publishes {TOPIC}; expected a simulation, or clock: wall")
        if not wait(self._has_time):
            raise StudyError(f"no message on {TOPIC}; is the simulation paused?")

    @property
    def now(self) -> int:
        """The latest time [ns]."""
        return self._times[-1]

    @property
    def steady(self) -> int:
        """The same: a simulation may be reset, but not in a run."""
        return self.now

    def begin(self) -> None:
        """Start a run."""
        self.update()
        del self._received[:-1], self._times[:-1]
        self._is_running = True

    def end(self) -> None:
        """End the run."""
        self._is_running = False

    def update(self) -> None:
        """Take what came."""
        handle = self._subscription.handle
        with handle:
            while (item := handle.take_message(ClockMessage, False)) is not None:
                message, info = item
                stamp = message.clock.sec * 1_000_000_000 + message.clock.nanosec
                self._add(stamp, info["received_timestamp"])

    def look(self) -> None:
        """Take what came, and refuse a clock that stands still, or was set back in a run."""
        now = time.monotonic()
        if now - self._checked > UNWATCHED:
            # Between two runs a simulation may be paused.
            self._advanced = now
        self._checked = now
        self.update()
        if now - self._advanced > LONGEST_STANDSTILL:
            raise LostError(
                f"{TOPIC} has not advanced for {LONGEST_STANDSTILL:g} s; it is at "
                f"{self.now * 1e-9:.3f} s"
            )

    def at(self, received: int) -> int:
        """Return the latest time [ns] that came before."""
        return self._times[max(bisect_right(self._received, received) - 1, 0)]

    def _has_time(self) -> bool:
        self.update()
        return bool(self._times)

    def _add(self, stamp: int, received: int) -> None:
        before = self._times[-1] if self._times else -1
        if stamp == before:
            return
        self._advanced = time.monotonic()
        if stamp < before:
            # Between two runs a simulation may be reset.
            self._received.clear()
            self._times.clear()
        self._received.append(received)
        self._times.append(stamp)
        if stamp < before and self._is_running:
            raise DisturbedError(
                f"{TOPIC} jumped back from {before * 1e-9:.3f} s to {stamp * 1e-9:.3f} s in the run"
            )


class Stopwatch:
    """Time that has passed by a clock, which may be set meanwhile."""

    def __init__(self, clock: RunClock) -> None:
        self._clock = clock
        self._last = clock.steady
        self._passed = 0

    @property
    def seconds(self) -> float:
        """Time [s] that has passed since this was made."""
        now = self._clock.steady
        self._passed += max(now - self._last, 0)
        self._last = now
        return self._passed * 1e-9


def to_stamp(nanoseconds: int) -> Time:
    """Make a stamp of a time [ns]."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def check_wall_clock() -> None:
    """Refuse a wall clock with a time that no ROS message can hold: every run would be refused."""
    now = time.time()
    if not 0.0 <= now <= END_OF_TIME - MARGIN:
        shown = time.strftime("%Y-%m-%d", time.gmtime(now))
        raise BackendError(
            f"the clock of this machine shows {shown}; ROS messages hold times from 1970 to 2038"
        )
