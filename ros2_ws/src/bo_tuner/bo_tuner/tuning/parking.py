"""Parks the machine while a run waits."""

import time
from collections.abc import Callable, Collection

from bo_tuner.tuning.observer import RunObserver

AGAIN = 5.0
"""Time [s] after which a machine that was not parked is parked again."""


class ParkInPause(RunObserver):
    """Sets the safe parameters at the start of a pause, and again until the nodes have them."""

    def __init__(self, park: Callable[[], list[str]], warn: Callable[[str], None]) -> None:
        self._park = park
        self._warn = warn
        self._problems: list[str] = []
        self._next = 0.0

    def pause(self, paused: bool) -> None:
        """Park; the next evaluation sets its own parameters."""
        self._problems = []
        if paused:
            self._try()

    def waiting(self) -> None:
        """Park again if that failed."""
        if self._problems and time.monotonic() >= self._next:
            self._try(self._problems)
            if not self._problems:
                self._warn("the nodes have their safe parameters now")

    def _try(self, known: Collection[str] = ()) -> None:
        self._problems = self._park()
        self._next = time.monotonic() + AGAIN
        for problem in self._problems:
            if problem not in known:
                self._warn(f"warning: {problem}")
