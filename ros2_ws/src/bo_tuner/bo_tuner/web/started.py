"""A command that a page has started: one at a time, what it prints, and its end."""

import asyncio
import contextlib
import shlex
import signal
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence

from bo_tuner.errors import BoTunerError
from bo_tuner.text import printable

COMMANDS = (sys.executable, "-P", "-m", "bo_tuner")
MOST_LINES = 200
"""Lines of its output that a page shows, the latest."""
LONGEST_LINE = 64_000
"""Bytes of a line that are read as one."""
PATIENCE = 25.0
"""Longest time [s] that a question for news is open, well below what browsers and tunnels allow."""


class RunningError(BoTunerError):
    """A command cannot be started, as another one is running or otherwise."""


class Started:
    """Starts commands, each when the one before it has ended.

    Parameters
    ----------
    tell
        Takes a line on what is started, and how it ended.
    program
        Takes the words of a command as its arguments.
    """

    def __init__(self, tell: Callable[[str], None], program: Sequence[str] = COMMANDS) -> None:
        self._tell = tell
        self._program = program
        self._command = ""
        self._lines: deque[str] = deque(maxlen=MOST_LINES)
        self._is_running = False
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Task[None] | None = None
        self._exit_code: int | None = None
        self._version = 0
        self._changed = asyncio.Event()

    async def start(self, words: Sequence[str], asked_by: str) -> None:
        """Start a command; `asked_by` is where from.

        Raises
        ------
        RunningError
            If the one before it has not ended.
        """
        if self._is_running:
            raise RunningError(f"{self._name} is running: end it first")
        self._is_running = True
        self._command, self._exit_code = shlex.join(words), None
        self._lines.clear()
        self._tell(f"started from the page by {asked_by}: {self._command}")
        try:
            self._process = await asyncio.create_subprocess_exec(
                *self._program,
                *words,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                limit=LONGEST_LINE,
                # Ctrl-C on the terminal is for the server, which passes it on.
                start_new_session=True,
            )
        except OSError as error:
            self._is_running = False
            raise RunningError(f"{self._name} cannot be started: {error.strerror}") from error
        self._tell_readers()
        self._reading = asyncio.create_task(self._read(self._process))

    def stop(self) -> None:
        """Ask the command to end, as Ctrl-C does: it leaves the machine safe."""
        if self._is_running and self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)

    async def news(self, version: int) -> dict[str, object]:
        """Return what the command has printed, once there is another version of it."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE):
                while self._version == version:
                    await self._changed.wait()
        return {
            "version": self._version,
            "command": self._command,
            "lines": list(self._lines),
            "running": self._is_running,
            "exit_code": self._exit_code,
        }

    async def close(self) -> None:
        """End the command, and wait until it has left the machine safe."""
        if self._is_running and self._reading is not None:
            self._tell(f"waiting until {self._name} has ended")
            self.stop()
            await self._reading

    @property
    def _name(self) -> str:
        return self._command.split()[0]

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        if process.stdout is not None:
            async for line in _lines(process.stdout):
                self._lines.append(line)
                self._tell_readers()
        self._exit_code = await process.wait()
        self._is_running = False
        self._tell(f"{self._name} has ended with exit code {self._exit_code}")
        self._tell_readers()

    def _tell_readers(self) -> None:
        self._version += 1
        self._changed.set()
        self._changed = asyncio.Event()


async def _lines(stream: asyncio.StreamReader) -> AsyncIterator[str]:
    """Yield what is printed, fit for a page; of a line that is too long its end."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:
            continue
        if not line:
            return
        yield printable(line.decode("utf-8", "replace").rstrip())
