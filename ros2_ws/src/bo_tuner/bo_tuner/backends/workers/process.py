"""What runs in the process of a worker: a backend of its own, and one evaluation after the other.

Dask calls these functions. What they tell they return: an exception would cross the processes with
its traceback, and leave its fields behind.
"""

import asyncio
import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol, cast, runtime_checkable

from distributed import Scheduler, SchedulerPlugin, Worker, WorkerPlugin, get_worker

from bo_tuner import maxima
from bo_tuner.backends.protocol import Backend
from bo_tuner.backends.workers.answer import Answer, MakeBackend
from bo_tuner.backends.workers.identity import Needs, differences, identity
from bo_tuner.errors import BackendError, BoTunerError, MetricsError
from bo_tuner.interruption import Interrupted
from bo_tuner.storage.host_lock import host_lock
from bo_tuner.trials import Evaluation

IN_PARENT = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
"""Sent by a terminal to all processes; the run takes them, and ends its workers."""
LOOK_AROUND = 0.05
"""Time [s] after which a wait for the end of a backend looks again."""


class Parks(Protocol):
    """A backend whose nodes have safe parameters to be set."""

    def park(self) -> list[str]:
        """Set them; returns what went wrong."""


@runtime_checkable
class Hears(Protocol):
    """A backend that has heard something of the last evaluation, which goes with the result."""

    heard: object


@dataclass(frozen=True)
class Order:
    """What each worker of a run gets to know of it.

    Attributes
    ----------
    run
        Name of the run, by which its functions find the backend.
    make
        Makes the backend of a worker.
    needs, expected
        What a worker must have, and what of it the run has; None where they are processes of one
        installation.
    patience
        Time [s] that a backend has to close.
    """

    run: str
    make: MakeBackend
    needs: Needs | None
    expected: Mapping[str, str]
    patience: float

    @property
    def in_cluster(self) -> bool:
        """Whether the process was there before the run, and outlives it."""
        return self.needs is not None


class OwnBackend(WorkerPlugin):
    """The backend of a worker, made in its process, also in one that takes the place of another."""

    def __init__(self, order: Order) -> None:
        self.order = order
        self.name = order.run
        self.lock = threading.Lock()
        self.label = ""
        self._backend: Backend | None = None
        self._ending = threading.Event()
        self._number = 0
        self._claim: IO[str] | None = None
        self._host_folder = Path()

    def __getstate__(self) -> dict[str, object]:
        """Leave behind what is of one process."""
        return {"order": self.order}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Begin in a new process."""
        OwnBackend.__init__(self, cast(Order, state["order"]))

    def setup(self, worker: Worker) -> None:
        """Get ready to be asked; in the main thread."""
        # Each worker takes a free domain; the one that the user names is the run's.
        os.environ.pop("ROS_DOMAIN_ID", None)
        # Dask has a folder of the process, which ends with it, two below the one that it was given.
        self._host_folder = Path(worker.local_directory).parents[1]
        if self.order.in_cluster:
            self.label = worker.address
            return
        # Nobody is to read of its tasks.
        worker.http_server.stop()
        self._number = int(str(worker.name)) + 1
        self.label = str(self._number)
        for signum in IN_PARENT:
            # A handler, and not SIG_IGN, which what is started would inherit.
            signal.signal(signum, lambda _signum, _frame: None)

    async def teardown(self, worker: Worker) -> None:
        """Close what nobody has closed, or is about to: the run may have been killed."""
        del worker
        if not self._ending.is_set():
            await self.close()

    def opened(self) -> Backend:
        """Return the backend, which is made and opened on the first call."""
        if self._backend is None:
            self._check()
            if self.order.needs is not None:
                self._check_installation(self.order.needs)
                self._number = self._number or self._number_on_host()
            backend = self.order.make(self._number, self._host_folder, self._check)
            try:
                backend.open()
            except BaseException:
                with contextlib.suppress(BackendError):
                    backend.close()
                raise
            self._backend = backend
        return self._backend

    @property
    def is_open(self) -> bool:
        """Whether there is a backend."""
        return self._backend is not None

    def _check_installation(self, needs: Needs) -> None:
        """Refuse to run other code than the run has."""
        found = identity(needs.packages, needs.modules, needs.folder)
        if text := differences(self.order.expected, found):
            raise BackendError(f"does not have what the run has: {text}")

    def _number_on_host(self) -> int:
        """Claim the first number that no other worker of this host has."""
        for number in range(1, maxima.WORKERS + 1):
            if (claim := host_lock(f"worker{number}")) is not None:
                self._claim = claim
                return number
        raise BackendError(f"more than {maxima.WORKERS} workers on one host")

    async def close(self) -> list[str]:
        """Break off what goes on, and close the backend; returns what went wrong.

        Foreign code that does not come to an end is not waited for beyond the patience; when it
        does, the backend is closed.
        """
        self._ending.set()
        problems: list[str] = []
        # Not in a task: this process may have one of somebody else's.
        closing = threading.Thread(target=self._close, args=(problems,), daemon=True)
        closing.start()
        deadline = time.monotonic() + self.order.patience
        while closing.is_alive() and time.monotonic() < deadline:
            await asyncio.sleep(LOOK_AROUND)
        return problems

    def _close(self, problems: list[str]) -> None:
        with self.lock:
            backend, self._backend = self._backend, None
            try:
                if backend is not None:
                    backend.close()
            except BackendError as error:
                problems.append(str(error))
            finally:
                claim, self._claim = self._claim, None
                if claim is not None:
                    claim.close()

    def _check(self) -> None:
        if self._ending.is_set():
            raise Interrupted(signal.SIGTERM, "the end of the run")


class EndWithRun(SchedulerPlugin):
    """Has the workers of a cluster let go of a run whose process is gone."""

    def __init__(self, run: str, client: str) -> None:
        self.name = f"{run}-end"
        self._run = run
        self._client = client
        self._ends: set[asyncio.Task[Any]] = set()

    def remove_client(self, scheduler: Scheduler, client: str) -> None:
        """Take the backends from the workers, when the connection of the run has ended."""
        if client != self._client:
            return
        if self._run in scheduler.worker_plugins:
            end = scheduler.unregister_worker_plugin(None, self._run)
            task = asyncio.ensure_future(end)
            self._ends.add(task)
            task.add_done_callback(self._ends.discard)
        scheduler.remove_plugin(self.name)


def _answered(run: str, act: Callable[[OwnBackend], Answer]) -> Answer:
    """Do something with the worker's backend; whatever it raises is an answer."""
    worker = get_worker()
    own = worker.plugins.get(run)
    if own is None:
        return Answer(worker.address, problem="has let go of the run, as the connection was lost")
    own = cast(OwnBackend, own)
    try:
        with own.lock:
            return act(own)
    except Interrupted:
        return Answer(own.label, problem="interrupted")
    except BoTunerError as error:
        return Answer(own.label, problem=str(error), returned=isinstance(error, MetricsError))
    except Exception as error:
        return Answer(own.label, problem=f"{type(error).__name__}: {error}")
    except (SystemExit, KeyboardInterrupt):
        # Of foreign code. Dask would take it for an end that is meant, and start no other process.
        os._exit(1)


def begin(run: str) -> Answer:
    """Open the backend."""

    def act(own: OwnBackend) -> Answer:
        own.opened()
        return Answer(own.label)

    return _answered(run, act)


def evaluate(run: str, planned: Evaluation) -> Answer:
    """Run an evaluation."""

    def act(own: OwnBackend) -> Answer:
        backend = own.opened()
        (evaluation,) = backend.run([planned])
        heard = backend.heard if isinstance(backend, Hears) else None
        return Answer(own.label, evaluation, heard=heard)

    return _answered(run, act)


def park(run: str) -> Answer:
    """Leave the nodes, if there are any, with their safe parameters, once what runs has ended."""

    def act(own: OwnBackend) -> Answer:
        remarks = cast(Parks, own.opened()).park() if own.is_open else []
        return Answer(own.label, remarks=tuple(remarks))

    return _answered(run, act)


async def close(run: str, dask_worker: Worker) -> Answer:
    """Break off what runs, and close the backend; Dask calls it beside that."""
    own = cast(OwnBackend, dask_worker.plugins[run])
    return Answer(own.label, remarks=tuple(await own.close()))
