"""Requests from outside that a run notices between two steps: to end, or to wait."""

import contextlib
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TypeVar

T = TypeVar("T")

SIGNALS = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
    signal.SIGXCPU,
)
"""Signals that end a process, and would leave a machine running."""
PATIENCE = 1.0
"""Time [s] that an object at work has to come to its end after a request: else all is lost."""
LOOK_AROUND = 0.1
"""Time [s] after which a run that waits checks for other requests."""
PROMISED = 60.0
"""Longest time [s] for which another process, a pipe or a mount is waited for that says nothing."""


class Interrupted(BaseException):
    """Somebody asks for the end of the run, by a signal or as if by one.

    It is a request and no error, so handlers of errors of foreign code do not catch it.
    """

    def __init__(self, signum: int, source: str = "") -> None:
        super().__init__(source or signal_name(signum))
        self.signum = signum


class Interruption:
    """Takes `SIGNALS` from its making on; make it in the main thread.

    A signal that is ignored, such as SIGHUP under ``nohup``, stays ignored, but for SIGINT and
    SIGTERM.
    """

    def __init__(self) -> None:
        self._request: tuple[int, str] | None = None
        for signum in SIGNALS:
            always = signum in (signal.SIGINT, signal.SIGTERM)
            if always or signal.getsignal(signum) is not signal.SIG_IGN:
                signal.signal(signum, self._take)

    @property
    def signum(self) -> int | None:
        """The signal that asked for the end; None if nothing did."""
        return None if self._request is None else self._request[0]

    def check(self) -> None:
        """Raise `Interrupted` if the end was asked for."""
        if self._request is not None:
            raise Interrupted(*self._request)

    def request(self, source: str) -> None:
        """Ask for the end as SIGTERM does; from any thread.

        Parameters
        ----------
        source
            Who asks, in a few words.
        """
        self._request = (signal.SIGTERM, source)

    def keep_running(self) -> None:
        """Disregard Ctrl-Z from now on: nobody would watch the machine."""
        # Nodes that are started would inherit a signal that is ignored, but no handler.
        signal.signal(signal.SIGTSTP, lambda _signum, _frame: None)

    def ignore(self) -> None:
        """Ignore further signals, so that they do not disturb the end of the run."""
        for signum in SIGNALS:
            signal.signal(signum, signal.SIG_IGN)

    def _take(self, signum: int, _frame: FrameType | None) -> None:
        self._request = (signum, "")


@contextlib.contextmanager
def breaking_off(check: Callable[[], None]) -> Iterator[None]:
    """Let signals end what is done inside: foreign code, which checks for no request.

    It has `PATIENCE` to come to its end by itself; a second signal ends it at once. Code that does
    not come back to Python is not reached.

    Parameters
    ----------
    check
        Called then; raises what shall end it.
    """
    if threading.current_thread() is not threading.main_thread():
        # Python hands signals to the main thread alone.
        yield
        return
    previous = {signum: signal.getsignal(signum) for signum in SIGNALS}
    handlers = {int(signum): handler for signum, handler in previous.items() if callable(handler)}
    again: list[threading.Timer] = []

    def take(signum: int, frame: FrameType | None) -> None:
        handlers[signum](signum, frame)
        if again:
            check()
            return
        again.append(threading.Timer(PATIENCE, os.kill, (os.getpid(), signum)))
        again[0].daemon = True
        again[0].start()

    for signum in handlers:
        signal.signal(signum, take)
    try:
        yield
    finally:
        for timer in again:
            timer.cancel()
        for signum, handler in handlers.items():
            signal.signal(signum, handler)


def signal_name(signum: int) -> str:
    """Return the name of a signal; a number, where it has none (real-time signals)."""
    try:
        return signal.Signals(signum).name
    except ValueError:
        return f"signal {signum}"


def waited_for(
    act: Callable[[], T], seconds: float = PROMISED, check: Callable[[], None] = lambda: None
) -> T:
    """Return what a call returns that may never come back, such as one to another process.

    Parameters
    ----------
    act
        The call; it is left behind, in a thread of its own, if the wait ends first.
    seconds
        Longest time [s] to wait; may be infinite.
    check
        Called all the while; raises what shall end the wait.

    Raises
    ------
    TimeoutError
        If the call has not come back by then.
    """
    ends: queue.SimpleQueue[tuple[T | None, BaseException | None]] = queue.SimpleQueue()

    def call() -> None:
        try:
            ends.put((act(), None))
        except BaseException as error:
            ends.put((None, error))

    threading.Thread(target=call, daemon=True).start()
    deadline = time.monotonic() + seconds
    while True:
        check()
        left = deadline - time.monotonic()
        try:
            value, error = ends.get(timeout=max(0.0, min(LOOK_AROUND, left)))
        except queue.Empty:
            if left <= 0.0:
                raise TimeoutError(f"no answer in {seconds:g} s") from None
            continue
        if error is not None:
            raise error
        return value  # type: ignore[return-value]


def content_of_file(path: Path, most: int) -> bytes:
    """Return a file that a user has named, which may be a pipe, or lie where nothing answers.

    Parameters
    ----------
    path
        Of the file.
    most
        Largest size [byte]; of a larger one there is a byte more.

    Raises
    ------
    OSError
        If it cannot be read, or in the `PROMISED` time.
    Interrupted
        If the end of the command is asked for meanwhile.
    """

    def read() -> bytes:
        with path.open("rb") as file:
            return file.read(most + 1)

    # Whoever reads files need not know who takes the signals of this process.
    taking = getattr(signal.getsignal(signal.SIGTERM), "__self__", None)
    if isinstance(taking, Interruption):
        return waited_for(read, check=taking.check)
    return waited_for(read)


class Pause:
    """Makes a run wait between two evaluations while it is asked to; asked from any thread."""

    def __init__(self) -> None:
        self._go_on = threading.Event()
        self._go_on.set()

    @property
    def requested(self) -> bool:
        """Whether the run shall wait."""
        return not self._go_on.is_set()

    def request(self, wait: bool) -> None:
        """Ask the run to wait, or to go on."""
        (self._go_on.clear if wait else self._go_on.set)()

    def wait(self, check: Callable[[], None]) -> None:
        """Return once the run shall go on.

        Parameters
        ----------
        check
            Called all the while; raises what shall end the wait.
        """
        while not self._go_on.wait(LOOK_AROUND):
            check()
