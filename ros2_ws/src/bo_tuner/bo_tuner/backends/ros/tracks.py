"""The values of one signal as they come in, and when each was true."""

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from bo_tuner.backends.ros.clock import RunClock
from bo_tuner.backends.ros.readers import Value
from bo_tuner.numerics.arrays import Array


@dataclass
class Track:
    """The values of one signal, and when each was true [ns since the epoch].

    Attributes
    ----------
    newest
        What came last, late or not.
    late
        Messages in the run whose stamp is not after that of one before.
    offset
        Time [ns] by which the stamp of the newest is ahead of the clock at its reception.
    stale
        Longest time [ns] for which several of them in a row lie behind, or have come.
    size
        Bytes of the whole messages that are kept, of a signal of these.
    """

    clock: RunClock
    stamps: list[int] = field(default_factory=list)
    values: list[Value] = field(default_factory=list)
    newest: Value = np.nan
    late: int = 0
    stale: int = 0
    in_run: bool = False
    offset: int = 0
    size: int = 0
    late_values: list[Value] = field(default_factory=list)
    in_a_row: int = 0
    row_began: int = 0

    def add(self, stamp: int | None, value: Value, received: int) -> None:
        """Take a value."""
        self.newest = value
        if stamp is not None:
            self.offset = stamp - self.clock.at(received)
        else:
            stamp = self.clock.at(received)
            if self.clock.coarse and self.stamps and stamp == self.stamps[-1]:
                # Of what comes between two ticks of the clock the last one holds.
                self.values[-1] = value
                return
        if self.stamps and stamp <= self.stamps[-1]:
            if self.in_run:
                self._add_late(value, self.stamps[-1] - stamp, self.clock.at(received))
                return
            # What was said of later times holds no more, as of a simulation that was reset.
            while self.stamps and self.stamps[-1] >= stamp:
                self.stamps.pop()
                self.values.pop()
        self.in_a_row = 0
        self.stamps.append(stamp)
        self.values.append(value)
        if isinstance(value, bytes):
            self.size += len(value)

    def take_late(self) -> Array:
        """Return the late values since the last call, and what came last if that is behind."""
        values = [*self.late_values, self.newest] if self.late_values or self.in_a_row else []
        self.late_values.clear()
        return np.array(values)

    def _add_late(self, value: Value, behind: int, received: int) -> None:
        self.late += 1
        self.late_values.append(value)
        self.in_a_row += 1
        if self.in_a_row == 1:
            self.row_began = received
        else:
            self.stale = max(self.stale, behind, received - self.row_began)

    def forget(self) -> None:
        """Forget all that came."""
        self.stamps.clear()
        self.values.clear()
        self.late_values.clear()
        self.newest = np.nan
        self.in_a_row = 0
        self.size = 0

    def begin(self, now: int, in_run: bool) -> None:
        """Count from now on, and keep of what came before only the latest."""
        self.in_run = in_run
        del self.stamps[:-1], self.values[:-1]
        # A stamp may lie ahead, as of a clock that was set back: the value holds now all the same.
        self.stamps[:] = [min(stamp, now - 1) for stamp in self.stamps]
        self.late = self.stale = self.in_a_row = 0
        self.size = sum(len(value) for value in self.values if isinstance(value, bytes))
        self.late_values.clear()

    def between(self, began: int, since: float, end: float) -> tuple[Array, list[Value]]:
        """Return times (n,) [s] since `began` [ns], and values (n,).

        They are from the last one before `since` [s] on until `end` [s]; of those before the start
        the last one holds there.
        """
        first = 0
        if since > -np.inf:
            first = max(bisect_right(self.stamps, began + round(since * 1e9)) - 1, 0)
        last = bisect_right(self.stamps, began + round(end * 1e9))
        first = max(first, bisect_right(self.stamps, began - 1) - 1)
        stamps = np.array(self.stamps[first:last], dtype=np.int64) - began
        return (stamps * 1e-9).astype(np.float64), self.values[first:last]
