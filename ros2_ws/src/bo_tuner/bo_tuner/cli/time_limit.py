"""The longest time that a command may take: an option."""

import argparse
import math
import re
import time
from dataclasses import dataclass, field

from bo_tuner.text import rounded_time

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}

_TIME = re.compile(r"(\d+(?:\.\d+)?) ?(s|min|h)", re.ASCII)


@dataclass(frozen=True)
class TimeLimit:
    """A time from now on.

    Attributes
    ----------
    seconds
        Its length [s]; infinite without a limit.
    """

    seconds: float = math.inf
    _begin: float = field(default_factory=time.monotonic)

    @property
    def over(self) -> bool:
        """Whether it has passed."""
        return time.monotonic() - self._begin >= self.seconds

    @property
    def endless(self) -> bool:
        """Whether there is no limit."""
        return math.isinf(self.seconds)

    @property
    def outcome(self) -> str:
        """How much of it was taken until now, in words."""
        taken = rounded_time(self.seconds - self.left)
        return f"took {taken} of {rounded_time(self.seconds)}"

    @property
    def left(self) -> float:
        """What is left of it [s]; negative once it has passed."""
        return self.seconds - (time.monotonic() - self._begin)


def time_limit(text: str) -> TimeLimit:
    """Read an option's time, such as ``90s``, ``10min`` or ``2h``, which begins now."""
    found = _TIME.fullmatch(text)
    seconds = float(found[1]) * UNITS[found[2]] if found else 0.0
    if not 0.0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: expected a time such as 90s, 10min or 2h")
    return TimeLimit(seconds)
