"""A Python process that runs code of others, and is asked one question after the other.

Whatever that code does there ends with the process: a loop that no signal reaches, a crash, an
exit.
"""

import contextlib
import math
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.interruption import PROMISED, signal_name, waited_for
from bo_tuner.lifetime import end_with_parent

LOADING = PROMISED
"""Time [s] at least that the code of others has to be imported, which no timeout of a run is for.
"""
ENDING = 5.0
"""Time [s] that a process has to end which has closed its end of the connection."""


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
        self._number = 0

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
        self._number += 1
        number = self._number

        def exchange() -> Any:
            connection.send((number, question))
            while True:
                of_number, answer = connection.recv()
                if of_number == number:
                    return answer

        def check() -> None:
            self._interrupted()
            if process.poll() is not None and not connection.poll():
                # What it has started may keep its end of the connection open.
                raise EOFError

        try:
            return waited_for(exchange, math.inf if timeout is None else timeout, check)
        except TimeoutError:
            self.close()
            raise NoAnswerError(f"took longer than its timeout of {timeout:g} s") from None
        except (EOFError, OSError):
            # That it ended is seen ahead of how.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(ENDING)
            self.close()
            raise NoAnswerError(f"ended its process: {_how_it_ended(process)}") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the process at once, with all that it has started in its group."""
        process, self._process = self._process, None
        connection, self._connection = self._connection, None
        if process is not None:
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except (ProcessLookupError, PermissionError):
                process.kill()
            process.wait()
        if connection is not None:
            # Whoever still reads it is told; what the process has started may have its other end.
            with connection, socket.socket(fileno=os.dup(connection.fileno())) as ends:
                ends.shutdown(socket.SHUT_RDWR)

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


def serve(connection: Connection, answer: Callable[[Any], object]) -> None:
    """Answer questions in the process that is asked, until the other end is closed."""
    asked = os.getpid()
    while True:
        try:
            number, question = connection.recv()
        except EOFError:
            return
        answered = answer(question)
        if os.getpid() != asked:
            # A child that the code has forked has come back, too.
            os._exit(0)
        connection.send((number, answered))


def _how_it_ended(process: subprocess.Popen[bytes]) -> str:
    code = process.returncode
    if code is None:
        return "no answer"
    if code < 0:
        return f"killed by {signal_name(-code)}"
    return f"exit code {code}"
