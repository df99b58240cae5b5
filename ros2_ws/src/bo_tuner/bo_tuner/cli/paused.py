"""A run that waits goes on by a key on its terminal, too: not everybody has ``ros2``."""

import os
import sys
from collections.abc import Callable

from bo_tuner.cli.streams import typed
from bo_tuner.tuning.observer import RunObserver

KEY = "c"
WAY = f"by {KEY} and Enter here"


def has_terminal() -> bool:
    """Whether a user can type something to this process; one in the background is stopped by it."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


class ContinueByKey(RunObserver):
    """Lets a paused run go on when the user types `KEY`."""

    def __init__(self, go_on: Callable[[], object]) -> None:
        self._go_on = go_on
        self._listens = False

    def pause(self, paused: bool) -> None:
        """Listen from the start of a pause on; what was typed before it is not meant for it."""
        self._listens = paused
        while self._listens and self._line() is not None:
            pass

    def asking(self, asked: bool) -> None:
        """Leave the terminal to the question."""

    def waiting(self) -> None:
        """Look for what is typed."""
        if self._listens and (self._line() or "").lower() == KEY:
            self._go_on()

    def _line(self) -> str | None:
        if not has_terminal():
            return None
        try:
            return typed(0.0)
        except EOFError:
            self._listens = False
            return None
