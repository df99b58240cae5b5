"""Time in which this process did not run: stopped by SIGSTOP, or the lid of a laptop closed."""

import time

LONGEST = 5.0
"""Gap [s] between two checks beyond which this process was suspended: it checks every 0.1 s
while it waits, and takes less to handle what came."""


class Suspension:
    """The longest gap between two readings of the clock."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Begin anew; what was before does not count."""
        self._last = _now()
        self._longest = 0.0

    def look(self) -> None:
        """Read the clock."""
        now = _now()
        self._longest = max(self._longest, now - self._last)
        self._last = now

    def skip(self) -> None:
        """Leave out the time since the last reading, in which this process waited without one."""
        self._last = _now()

    @property
    def seconds(self) -> float:
        """How long this process was suspended [s]; 0 if it was not."""
        return self._longest if self._longest > LONGEST else 0.0

    @property
    def longest(self) -> float:
        """The longest gap between two readings [s]; this process may have computed in it, too."""
        return self._longest


def _now() -> float:
    """Return a steady time [s] that goes on while the machine sleeps."""
    # Elsewhere than on Linux there is no such clock; the steady one shows SIGSTOP at least.
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))
