"""Evaluations in several processes at once, of this machine or of a cluster, by Dask."""

import contextlib
import os
import queue
import signal
import time
import uuid
from asyncio import CancelledError
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

from bo_tuner.backends.workers.answer import Answer, MakeBackend
from bo_tuner.backends.workers.clusters import (
    LETTING_GO,
    RunningCluster,
    local_cluster,
    stopped_workers,
    workers_of,
)
from bo_tuner.errors import BackendError, MetricsError, RunError
from bo_tuner.interruption import LOOK_AROUND, PROMISED, waited_for
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

EXTRA = "several workers need the packages of the extra: pip install 'bo_tuner[workers]'"
CLOSING = 30.0
"""Time [s] that the backends of the workers have to close; then their processes are ended."""
BREAKING_OFF = 5.0
"""Time [s] of that for one that is to break an evaluation off in process: foreign code looks for no
request."""
CLOSING_MARGIN = 2.0
"""Time [s] that the workers have beyond that to say that they are done."""
LEFT_ALONE = PROMISED
"""Time [s] without any worker after which the run ends: others may take the place of those that
have died. A process that has been stopped for so long is ended."""
LOOK_FOR_WORKERS = 2.0
"""Time [s] after which a wait for results looks whether there are workers."""
LOST = ("lost", "pending")
"""What Dask says of a result that was there, and went with the process that had it."""


class WorkerPool:
    """Runs as many evaluations at once as there are workers.

    A worker is a process with a backend of its own. What one had that dies is run again, on any
    worker. On this machine it is started anew.
    """

    def __init__(
        self,
        name: str,
        workers: int,
        make: MakeBackend,
        interrupted: Callable[[], None] = lambda: None,
        patience: float = CLOSING,
        cluster: RunningCluster | None = None,
    ) -> None:
        self.name = name
        self.workers = workers
        self._make = make
        self._interrupted = interrupted
        self._patience = patience
        self._cluster = cluster
        self._run = f"bo_tuner-{uuid.uuid4().hex}"
        self._client: Any = None
        self._process: Any = None
        self._stack = contextlib.ExitStack()
        self._running: dict[Any, Evaluation] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._last_seen = 0.0
        self._next_look = 0.0
        self._stopped: dict[int, float] = {}
        self._latest: Answer | None = None

    def open(self) -> None:
        """Start the workers, and open their backends."""
        try:
            self._start()
            addresses = sorted(workers_of(self._client, self._interrupted))[: self.workers]
            for answer in self._ask_each(self._process.begin, addresses):
                if answer.problem:
                    raise BackendError(
                        f"worker {answer.worker} of {self.workers} cannot be started: "
                        f"{answer.problem}"
                    )
        except BaseException:
            with contextlib.suppress(BackendError):
                self.close()
            raise

    def _start(self) -> None:
        try:
            # Dask takes its time to be imported, and is there where several workers are wanted.
            from bo_tuner.backends.workers import process

            if self._cluster is None:
                connection = local_cluster(self.workers, self._interrupted)
            else:
                connection = self._cluster.connected(self._interrupted)
            client = self._stack.enter_context(connection)
        except ImportError as error:
            raise BackendError(f"{EXTRA} ({error.name or error})") from None
        cluster = self._cluster
        needs, expected = (None, {}) if cluster is None else (cluster.needs, cluster.expected)
        order = process.Order(self._run, self._make, needs, expected, self._patience)
        self._client, self._process = client, process
        plugins: list[Any] = [process.OwnBackend(order)]
        if cluster is not None:
            plugins.insert(0, process.EndWithRun(self._run, client.id))
        try:
            for plugin in plugins:
                waited_for(partial(client.register_plugin, plugin), check=self._interrupted)
        # Such as of workers that were killed just now.
        except OSError as error:
            self._interrupted()
            raise BackendError(self._gone(error)) from error
        self._interrupted()

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run evaluations; yields each as it ends.

        More are taken whenever a worker is free. Where there are no more it ends, after one result
        at least; a later call yields those that still run.
        """
        if self._client is None:
            raise BackendError("the backend is not open")
        due = iter(evaluations)
        has_yielded = False
        while self._fill(due):
            yield self._next()
            has_yielded = True
        # What has ended may have made others due, which only the next call has.
        if self._running and not has_yielded:
            yield self._next()

    def _fill(self, due: Iterator[Evaluation]) -> bool:
        """Give evaluations to the workers that are free; returns whether all have one."""
        while len(self._running) < self.workers:
            planned = next(due, None)
            if planned is None:
                return False
            self._submit(planned)
        return True

    def _submit(self, planned: Evaluation) -> None:
        future = self._client.submit(self._process.evaluate, self._run, planned, pure=False)
        self._running[future.key] = planned
        future.add_done_callback(self._ended.put)

    def _next(self) -> Evaluation:
        """Wait for the next result."""
        self._last_seen = time.monotonic()
        while True:
            self._look_around()
            try:
                future = self._ended.get(timeout=LOOK_AROUND)
            except queue.Empty:
                continue
            planned = self._running.pop(future.key, None)
            if planned is None:
                continue
            if (result := self._result(future, planned)) is not None:
                return result
            self._submit(planned)

    def _look_around(self) -> None:
        """Raise what shall end a wait: a request, or that there have been no workers for long."""
        self._interrupted()
        if time.monotonic() <= self._next_look:
            return
        self._end_stopped(LEFT_ALONE)
        if workers_of(self._client, self._interrupted):
            self._last_seen = time.monotonic()
        elif (seconds := time.monotonic() - self._last_seen) > LEFT_ALONE:
            raise RunError(f"no worker has been heard of for {seconds:.0f} s")
        self._next_look = time.monotonic() + LOOK_FOR_WORKERS

    def _end_stopped(self, after: float) -> None:
        """End workers that have been stopped for a time [s]; others take their place."""
        now = time.monotonic()
        stopped = stopped_workers(self._client)
        self._stopped = {pid: self._stopped.get(pid, now) for pid in stopped}
        for pid, since in self._stopped.items():
            if now - since >= after:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def take_answer(self) -> Answer | None:
        """Return what a worker has said with the latest result; None if it was taken, or lost."""
        answer, self._latest = self._latest, None
        return answer

    def _result(self, future: Any, planned: Evaluation) -> Evaluation | None:
        """Return an evaluation that has ended; None if its result went with its worker."""
        from distributed import KilledWorker

        self._latest = None
        try:
            answer = self._fetched(future)
        except _ResultLost:
            return None
        except KilledWorker as error:
            deaths = error.allowed_failures + 1
            reason = f"the process of the worker ended {deaths} times while it ran this"
            return replace(planned, outcome=Outcome(EvaluationState.LOST, {}, reason))
        if answer.evaluation is None:
            self._interrupted()
            if answer.returned:
                raise MetricsError(answer.problem)
            raise RunError(f"worker {answer.worker}: {answer.problem}")
        self._latest = answer
        return answer.evaluation

    def _fetched(self, future: Any) -> Answer:
        """Return what a worker has answered."""
        from distributed import KilledWorker

        def check() -> None:
            self._look_around()
            if future.status in LOST:
                raise _ResultLost

        try:
            return cast(Answer, waited_for(future.result, LEFT_ALONE, check))
        except TimeoutError:
            raise _ResultLost from None
        except (_ResultLost, KilledWorker, RunError):
            raise
        except (Exception, CancelledError) as error:
            # Such as that of an interrupted run, whose signal came meanwhile.
            self._interrupted()
            reason = error if future.status == "error" else future.status
            raise RunError(self._gone(reason)) from error

    def _gone(self, reason: object) -> str:
        if self._cluster is None:
            return f"the workers are gone ({reason})"
        return (
            f"the scheduler {self._cluster.address} is gone ({reason}); the run can go on with "
            "another one, or without --scheduler"
        )

    def park(self) -> list[str]:
        """Have each worker set the safe parameters, once its evaluation has ended."""
        addresses = workers_of(self._client, self._interrupted)
        answers = self._ask_each(self._process.park, addresses)
        return [
            f"worker {answer.worker}: {problem}"
            for answer in answers
            for problem in (*answer.remarks, *filter(None, [answer.problem]))
        ]

    def _ask_each(self, act: Callable[[str], Answer], addresses: Iterable[str]) -> Sequence[Answer]:
        """Ask workers for the same, and wait for their answers, which their backends see to."""
        known = workers_of(self._client, self._interrupted)
        names = {address: self._name(address, known) for address in addresses}
        futures = {
            name: self._client.submit(
                act, self._run, pure=False, workers=[address], allow_other_workers=False
            )
            for address, name in names.items()
        }
        answers: dict[str, Answer] = {}
        self._last_seen = time.monotonic()
        while pending := {name: futures[name] for name in names.values() if name not in answers}:
            self._end_stopped(LEFT_ALONE)
            # One that has died does not answer, and its successor has another address.
            known = workers_of(self._client, self._interrupted)
            alive = {name for address, name in names.items() if address in known}
            for name, future in pending.items():
                # One that had answered, and then died, has done what it was asked for.
                if future.status != "pending":
                    answers[name] = self._answer(name, future)
                elif not pending.keys() & alive:
                    answers[name] = Answer(name, problem="its process does not answer (pending)")
            time.sleep(LOOK_AROUND)
        return sorted(answers.values(), key=lambda answer: (len(answer.worker), answer.worker))

    def _answer(self, name: str, future: Any) -> Answer:
        """Return what a worker has said to what all are asked for."""
        from distributed import KilledWorker

        try:
            return self._fetched(future)
        except _ResultLost:
            return Answer(name)
        except (KilledWorker, RunError) as error:
            return Answer(name, problem=f"its process does not answer ({error})")

    def _name(self, address: str, known: Any) -> str:
        """Return what a worker is called, as it calls itself."""
        if self._cluster is not None or address not in known:
            return address
        return str(int(str(known[address]["name"])) + 1)

    def close(self) -> None:
        """Break off what runs, close the backends, and end the processes."""
        self._interrupted = lambda: None
        problems: list[str] = []
        try:
            if self._client is not None and self._client.status == "running":
                problems = self._close_backends(self._client)
        finally:
            self._client = None
            self._running.clear()
            with contextlib.suppress(TimeoutError):
                waited_for(self._stack.close, 2 * LETTING_GO)
        if problems:
            raise BackendError("; ".join(problems))

    def _close_backends(self, client: Any) -> list[str]:
        """Close the backends; returns what went wrong, each in a line."""
        problems: list[str] = []
        ended = set(stopped_workers(client).values())

        def close() -> None:
            # What fails here ends with the processes, or when the connection does.
            with contextlib.suppress(Exception):
                answers = client.run(
                    self._process.close,
                    self._run,
                    workers=[*(workers_of(client, self._interrupted).keys() - ended)],
                    on_error="ignore",
                )
                for answer in answers.values():
                    problems.extend(f"worker {answer.worker}: {text}" for text in answer.remarks)
                if self._cluster is not None:
                    client.unregister_worker_plugin(self._run)
                    client.unregister_scheduler_plugin(f"{self._run}-end")

        # A process in which foreign code has stopped all else answers nothing.
        with contextlib.suppress(TimeoutError):
            waited_for(close, self._patience + CLOSING_MARGIN, lambda: self._end_stopped(0.0))
        return problems


class _ResultLost(Exception):  # noqa: N818
    """A result went with the process that had it."""
