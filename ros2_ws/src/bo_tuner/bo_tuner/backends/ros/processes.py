"""Node processes that the tuner starts, and ends whatever happens."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from bo_tuner.errors import BackendError
from bo_tuner.interruption import signal_name
from bo_tuner.lifetime import end_with_parent
from bo_tuner.text import brief

STOP_TIMEOUT = 3.0
"""Time [s] that a node has to end after SIGTERM before it is killed."""

POLL = 0.02
NOT_RUN = (126, 127)
"""Exit codes of a shell that cannot run a program, or does not find it (POSIX, 2.8.2)."""
NOT_FOUND = re.compile(r"ModuleNotFoundError|ImportError|[Pp]ackage .*not found|shared librar")
MISSING = "install what it needs, or source its workspace in this terminal"

LAST_BYTES = 4096
"""Most that is read of what a node has printed last."""

# Waits for the end of its standard input, which is the end of the tuner, and then ends the group.
GUARD = """\
read group || exit
while read line; do :; done
kill -s TERM -- "-$group" && kill -s CONT -- "-$group" || exit
for wait in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15; do
    sleep 0.2
    kill -0 "-$group" || exit
done
kill -s KILL -- "-$group"
"""


def find_executable(package: str, executable: str) -> Path:
    """Find a node's executable where ``ros2 run`` would, or in the virtual environment."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in [*prefixes, sys.prefix]:
        file = Path(prefix) / "lib" / package / executable
        if os.access(file, os.X_OK):
            return file
    path = shutil.which(executable, path=search_path())
    if path is None:
        raise BackendError(
            f"{package}: no executable {executable}; install the package or source its workspace"
        )
    return Path(path)


def has_executable(package: str, executable: str) -> bool:
    """Return whether `find_executable` finds one."""
    try:
        find_executable(package, executable)
    except BackendError:
        return False
    return True


def search_path() -> str:
    """Return where programs are looked for: the virtual environment first."""
    return f"{sys.prefix}/bin{os.pathsep}{os.environ.get('PATH', os.defpath)}"


class NodeProcess:
    """One node in a process of its own, and what that starts in turn.

    They are a process group in a session of their own, so that Ctrl-C reaches the tuner alone, and
    end together: a node may stand behind a shell script. They end with the tuner, also when it is
    killed: the kernel then sends the process SIGTERM, and a shell that has waited for this ends the
    rest, and what was stopped by SIGSTOP. What has left the group, by a session of its own, is not
    reached.
    """

    def __init__(
        self,
        name: str,
        command: list[str],
        environment: Mapping[str, str],
        log: Path,
        folder: str | None = None,
    ) -> None:
        self.name = name
        self.log = log
        self._guard = _Guard()
        try:
            with log.open("ab") as output:
                self._process = subprocess.Popen(
                    command,
                    cwd=folder,
                    env=os.environ | dict(environment),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=end_with_parent(signal.SIGTERM),
                )
        except OSError as error:
            self._guard.end()
            raise BackendError(f"{command[0]}: cannot be started: {error.strerror}") from error
        self._guard.watch(self._process.pid)

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    @property
    def exit_reason(self) -> str | None:
        """How the process ended, with what it has printed last; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        if code < 0:
            how = f"{self.name} was ended by {signal_name(-code)}"
            return f"{how}; {self.said}" if self._last_line else how
        hint = f"; {MISSING}" if code in NOT_RUN or NOT_FOUND.search(self._last_line) else ""
        return f"{self.name} ended with exit code {code}; {self.said}{hint}"

    @property
    def said(self) -> str:
        """What it has printed last, and where the rest is."""
        last = self._last_line
        return f"its last line is '{last}', see {self.log}" if last else "it has printed nothing"

    @property
    def _last_line(self) -> str:
        """The last line that it has printed; empty if there is none, or it cannot be read."""
        try:
            with self.log.open("rb") as printed:
                printed.seek(max(printed.seek(0, os.SEEK_END) - LAST_BYTES, 0))
                lines = printed.read().decode(errors="replace").split("\n")
        except OSError:
            return ""
        return next((brief(line) for line in reversed(lines) if line.strip()), "")

    def ask_to_end(self) -> None:
        """Send SIGTERM, and do not wait."""
        self._signal(signal.SIGTERM)
        # A process that was stopped takes it only when it goes on.
        self._signal(signal.SIGCONT)

    def stop(self) -> None:
        """End the process and its group: SIGTERM first, SIGKILL if they do not follow."""
        self.ask_to_end()
        deadline = time.monotonic() + STOP_TIMEOUT
        while (self._process.poll() is None or self._signal(0)) and time.monotonic() < deadline:
            time.sleep(POLL)
        self._signal(signal.SIGKILL)
        self._process.wait()
        self._guard.end()

    def _signal(self, signum: int) -> bool:
        """Send a signal to the group; False if it has no process."""
        try:
            os.killpg(self._process.pid, signum)
        except (ProcessLookupError, PermissionError):
            return False
        return True


class _Guard:
    """A shell that ends a process group once this process is gone."""

    def __init__(self) -> None:
        end, self._pipe = os.pipe()
        try:
            self._shell = subprocess.Popen(
                ["/bin/sh", "-c", GUARD],
                stdin=end,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={"PATH": os.defpath},
                start_new_session=True,
            )
        finally:
            os.close(end)

    def watch(self, group: int) -> None:
        """Tell it which group."""
        os.write(self._pipe, f"{group}\n".encode())

    def end(self) -> None:
        """End it, with the group left alone."""
        self._shell.kill()
        self._shell.wait()
        os.close(self._pipe)


def stop_all(processes: Iterable[NodeProcess]) -> None:
    """End processes side by side."""
    together = list(processes)
    for process in together:
        process.ask_to_end()
    for process in together:
        process.stop()
