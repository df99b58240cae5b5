"""SIGINT and SIGTERM as a request that a run notices between two steps."""

import signal
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(Exception):  # noqa: N818 (a request, no error)
    """A signal asks for the end of the run."""

    def __init__(self, signum: int) -> None:
        super().__init__(signal.Signals(signum).name)
        self.signum = signum


class Interruption:
    """Takes SIGINT and SIGTERM from its making on; make it in the main thread."""

    def __init__(self) -> None:
        self._signum: int | None = None
        for signum in SIGNALS:
            signal.signal(signum, self._take)

    def check(self) -> None:
        """Raise `Interrupted` if a signal came."""
        if self._signum is not None:
            raise Interrupted(self._signum)

    def ignore(self) -> None:
        """Ignore further signals, so that they do not disturb the end of the run."""
        for signum in SIGNALS:
            signal.signal(signum, signal.SIG_IGN)

    def _take(self, signum: int, _frame: FrameType | None) -> None:
        self._signum = signum
