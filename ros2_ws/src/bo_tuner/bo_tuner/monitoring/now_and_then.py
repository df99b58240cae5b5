"""Progress in lines, for where there is no terminal: one now and then."""

import time
from collections.abc import Callable

PERIOD = 30.0
"""Least time [s] from any line to one that only says how far a phase is."""


class NowAndThen:
    """Says when the next line on the progress is due."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._printed = clock()

    def printed(self) -> None:
        """Note that there was a line, whatever it said."""
        self._printed = self._clock()

    @property
    def due(self) -> bool:
        """Whether there was no line for so long that one is due."""
        return self._clock() - self._printed >= PERIOD
