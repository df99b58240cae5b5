"""A Python process that runs code of others, and is asked one question after the other.

Whatever that code does there ends with the process: a loop that no signal reaches, a crash, an
exit.
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
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.interruption import LOOK_AROUND
from bo_tuner.lifetime import end_with_parent


class NoAnswerError(RuntimeError):
    """The process gave no answer: it has ended, or was ended for the time that it took."""


class AskedProcess:
    """The process; it is started when it is first needed, and again after it has ended.

    Parameters
    ----------
    module
        What it runs, as ``python -m`` has it: gets the number of its end of the socket.
    folder
        Where it works, and where modules are looked for last; empty for the present one.
    interrupted
        Asked while waiting; raises what shall end the wait, and with it the process.
    """

    def __init__(
        self, module: str, folder: str = "", interrupted: Callable[[], None] = lambda: None
    ) -> None:
        self._module = module
        self._folder = folder
        self._interrupted = interrupted
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    @property
    def running(self) -> bool:
        """Whether it is there."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Identifier of the process; None if it is not there."""
        return self._process.pid if self._process is not None and self.running else None

    def ask(self, question: object, timeout: float | None = None) -> Any:
        """Return the answer to a question; both are pickled.

        Parameters
        ----------
        question
            For the module to understand.
        timeout
            Longest time [s] until it answers; None for any.

        Raises
        ------
        NoAnswerError
            If there is none, with the reason.
        StudyError
            If the folder is not there.
        """
        process, connection = self._started()
        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            connection.send(question)
            while not connection.poll(LOOK_AROUND):
                self._interrupted()
                if process.poll() is not None and not connection.poll():
                    # What it has started may keep its end of the connection open.
                    raise EOFError
                if deadline is not None and time.monotonic() > deadline:
                    self.close()
                    raise NoAnswerError(f"took longer than its timeout of {timeout:g} s")
            return connection.recv()
        except (EOFError, OSError):
            # That it ended is seen ahead of how.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_AROUND)
            self.close()
            raise NoAnswerError(f"ended its process: {_how_it_ended(process)}") from None
        except BaseException:
            self.close()
            raise

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

    def _started(self) -> tuple[subprocess.Popen[bytes], Connection]:
        if not self.running:
            self.close()
        if self._process is None or self._connection is None:
            self._process, self._connection = self._start()
        return self._process, self._connection

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        if self._folder and not Path(self._folder).is_dir():
            raise StudyError(f"there is no folder {self._folder}", ("folder",))
        # Also for relative parts of Python's path, from another folder; the study's is last.
        path = [str(Path(part).absolute()) for part in sys.path]
        if self._folder:
            path.append(self._folder)
        own, other = Pipe()
        with other:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", self._module, str(other.fileno())],
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
