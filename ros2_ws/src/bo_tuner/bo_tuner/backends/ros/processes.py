"""Node processes that the tuner starts, and ends whatever happens."""

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from bo_tuner.errors import BackendError

STOP_TIMEOUT = 3.0
"""Time [s] that a node has to end after SIGTERM before it is killed."""

PR_SET_PDEATHSIG = 1


def find_executable(package: str, executable: str) -> Path:
    """Find a node's executable where ``ros2 run`` would, or in the virtual environment.

    Raises
    ------
    BackendError
        If it is in none of these places.
    """
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in [*prefixes, sys.prefix]:
        file = Path(prefix) / "lib" / package / executable
        if os.access(file, os.X_OK):
            return file
    path = f"{sys.prefix}/bin{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    found = shutil.which(executable, path=path)
    if found is None:
        raise BackendError(
            f"{package}: no executable {executable}; install the package or source its workspace"
        )
    return Path(found)


class NodeProcess:
    """One node in a process of its own.

    The process ends with the tuner, also when the tuner is killed: the kernel then sends it
    SIGTERM. It sits in a session of its own, so that Ctrl-C reaches the tuner alone.

    Parameters
    ----------
    package, executable
        Where the node's program is.
    arguments
        Its ``--ros-args``.
    environment
        Changes to this process's environment.
    log
        File that takes what the node prints.

    Raises
    ------
    BackendError
        If the executable is not found or cannot be run.
    """

    def __init__(
        self,
        package: str,
        executable: str,
        arguments: list[str],
        environment: Mapping[str, str],
        log: Path,
    ) -> None:
        self.name = executable
        self.log = log
        command = [str(find_executable(package, executable)), *arguments]
        try:
            with log.open("ab") as output:
                self._process = subprocess.Popen(
                    command,
                    env=os.environ | dict(environment),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=_end_with_parent(os.getpid()),
                )
        except OSError as error:
            raise BackendError(f"{command[0]}: cannot be started: {error.strerror}") from error

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    @property
    def exit_reason(self) -> str | None:
        """How the process ended, or None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        if code < 0:
            return f"{self.name} was ended by {signal.Signals(-code).name}"
        return f"{self.name} ended with exit code {code}; see {self.log}"

    def ask_to_end(self) -> None:
        """Send SIGTERM, and do not wait."""
        if self._process.poll() is None:
            self._process.terminate()

    def stop(self) -> None:
        """End the process: SIGTERM first, SIGKILL if it does not follow."""
        self.ask_to_end()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(STOP_TIMEOUT)
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()


def stop_all(processes: Iterable[NodeProcess]) -> None:
    """End processes side by side."""
    together = list(processes)
    for process in together:
        process.ask_to_end()
    for process in together:
        process.stop()


def _end_with_parent(parent: int) -> Callable[[], None] | None:
    if not sys.platform.startswith("linux"):
        return None
    prctl = ctypes.CDLL(None, use_errno=True).prctl

    def ask_for_signal() -> None:
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)

    return ask_for_signal
