"""Runs the functions by which a study computes metrics, in a process of their own.

Whatever they do there, such as an endless loop, a crash or an exit, ends with that process.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from bo_tuner.errors import StudyError
from bo_tuner.interruption import LOOK_AROUND
from bo_tuner.lifetime import end_with_parent
from bo_tuner.metrics.python_worker import Signals
from bo_tuner.metrics.source import MissingMetricError


class PythonProcess:
    """The process; it is started when it is first needed, and again after it has ended.

    Parameters
    ----------
    folder
        Where it works, and where modules are looked for last; empty for the present one.
    interrupted
        Called while waiting; what it raises ends the wait, and with it the process.
    """

    def __init__(self, folder: str, interrupted: Callable[[], None]) -> None:
        self._folder = folder
        self._interrupted = interrupted
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def load(self, path: str) -> str:
        """Import a function, ``module:name``; returns what was wrong, empty if nothing.

        Raises
        ------
        StudyError
            If the folder is not there.
        """
        return self._ask(path, None, None)[1]

    def compute(self, path: str, signals: Signals, timeout: float | None) -> float:
        """Return the value that a function computes from signals.

        Parameters
        ----------
        path
            The function.
        signals
            Its argument.
        timeout
            Longest time [s] that it may take; None for any.

        Raises
        ------
        MissingMetricError
            If that is no number, with the reason.
        """
        value, problem = self._ask(path, signals, timeout)
        if value is None:
            raise MissingMetricError(f"{path} {problem}")
        return value

    def close(self) -> None:
        """End the process at once, with all that it has started in its group."""
        process, self._process = self._process, None
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if process is not None:
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except (ProcessLookupError, PermissionError):
                process.kill()
            process.wait()

    def _ask(
        self, path: str, signals: Signals | None, timeout: float | None
    ) -> tuple[float | None, str]:
        process, connection = self._running()
        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            connection.send((path, signals))
            while not connection.poll(LOOK_AROUND):
                self._interrupted()
                if process.poll() is not None and not connection.poll():
                    # Processes that it has started may keep its end of the connection open.
                    raise EOFError
                if deadline is not None and time.monotonic() > deadline:
                    self.close()
                    return None, f"took longer than its timeout of {timeout:g} s"
            answer: tuple[float | None, str] = connection.recv()
            return answer
        except (EOFError, OSError):
            # The connection closes a moment before the exit code is known.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_AROUND)
            self.close()
            return None, f"ended its process: {_how_it_ended(process)}"
        except BaseException:
            self.close()
            raise

    def _running(self) -> tuple[subprocess.Popen[bytes], Connection]:
        if self._process is not None and self._process.poll() is not None:
            self.close()
        if self._process is None or self._connection is None:
            self._process, self._connection = self._start()
        return self._process, self._connection

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        if self._folder and not Path(self._folder).is_dir():
            raise StudyError(f"there is no folder {self._folder}", ("folder",))
        # Absolute, as the process works in another folder; the folder of the study comes last.
        path = [str(Path(part).absolute()) for part in sys.path if part]
        if self._folder:
            path.append(self._folder)
        own, other = Pipe()
        with other:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "bo_tuner.metrics.python_worker", str(other.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
                cwd=self._folder or None,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(path)},
                start_new_session=True,
                preexec_fn=end_with_parent(signal.SIGKILL),
            )
        return process, own


def _how_it_ended(process: subprocess.Popen[bytes]) -> str:
    code = process.returncode
    if code is None:
        return "no answer"
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit code {code}"
