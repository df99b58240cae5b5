"""What runs in the process of a worker: a backend of its own, and one evaluation after the other.

Dask calls these functions. What they tell they return: an exception would cross the processes with
its traceback, and leave its fields behind.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Callable
from typing import Protocol, cast

from distributed import Worker, WorkerPlugin, get_worker

from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.workers.answer import Answer, MakeBackend
from bo_tuner.errors import BackendError, BoTunerError, MetricsError
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import Evaluation

IN_PARENT = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
"""Sent by a terminal to all processes; the run takes them, and ends its workers."""


class Parks(Protocol):
    """A backend whose nodes have safe parameters to be set."""

    def park(self) -> list[str]:
        """Set them; returns what went wrong."""


class OwnBackend(WorkerPlugin):
    """The backend of a worker, made in its process, also in one that takes the place of another.

    Parameters
    ----------
    make
        Makes it.
    """

    name = "bo_tuner"

    def __init__(self, make: MakeBackend) -> None:
        self._make = make
        self._backend: Backend | None = None
        self._ending = threading.Event()
        self.number = 0

    def __getstate__(self) -> dict[str, object]:
        """Leave behind what is of one process."""
        return {"make": self._make}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Begin in a new process."""
        OwnBackend.__init__(self, cast(MakeBackend, state["make"]))

    def setup(self, worker: Worker) -> None:
        """Get ready to be asked; in the main thread."""
        self.number = int(str(worker.name)) + 1
        for signum in IN_PARENT:
            # A handler, and not SIG_IGN, which what is started would inherit.
            signal.signal(signum, lambda _signum, _frame: None)
        # Each worker takes a free domain; the one that the user names is the run's.
        os.environ.pop("ROS_DOMAIN_ID", None)

    def opened(self) -> Backend:
        """Return the backend, which is made and opened on the first call."""
        if self._backend is None:
            backend = self._make(self.number, self._check)
            try:
                backend.open()
            except BaseException:
                with contextlib.suppress(BackendError):
                    backend.close()
                raise
            self._backend = backend
        return self._backend

    def end(self) -> None:
        """Break off what goes on; from any thread."""
        self._ending.set()

    def close(self) -> None:
        """Close the backend."""
        backend, self._backend = self._backend, None
        if backend is not None:
            backend.close()

    def _check(self) -> None:
        if self._ending.is_set():
            raise Interrupted(signal.SIGTERM, "the end of the run")


def _own() -> OwnBackend:
    return cast(OwnBackend, get_worker().plugins[OwnBackend.name])


def _answered(act: Callable[[OwnBackend], Answer]) -> Answer:
    """Do something with the worker's backend; whatever it raises is an answer."""
    own = _own()
    try:
        return act(own)
    except Interrupted:
        return Answer(own.number, problem="interrupted")
    except BoTunerError as error:
        return Answer(own.number, problem=str(error), returned=isinstance(error, MetricsError))
    except Exception as error:
        return Answer(own.number, problem=f"{type(error).__name__}: {error}")


def begin() -> Answer:
    """Open the backend."""

    def act(own: OwnBackend) -> Answer:
        own.opened()
        return Answer(own.number)

    return _answered(act)


def evaluate(planned: Evaluation) -> Answer:
    """Run an evaluation."""

    def act(own: OwnBackend) -> Answer:
        (evaluation,) = own.opened().run([planned])
        return Answer(own.number, evaluation)

    return _answered(act)


def park() -> Answer:
    """Leave the nodes with their safe parameters, once what runs has ended."""

    def act(own: OwnBackend) -> Answer:
        return Answer(own.number, remarks=tuple(cast(Parks, own.opened()).park()))

    return _answered(act)


def close() -> Answer:
    """Close the backend."""

    def act(own: OwnBackend) -> Answer:
        own.close()
        return Answer(own.number)

    return _answered(act)


def end(dask_worker: Worker) -> None:
    """Break off what runs; Dask calls it beside that."""
    cast(OwnBackend, dask_worker.plugins[OwnBackend.name]).end()
