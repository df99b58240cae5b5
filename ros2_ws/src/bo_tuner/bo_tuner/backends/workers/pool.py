"""Evaluations in several processes of this machine at once: a cluster of Dask, of this run only."""

import contextlib
import queue
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from bo_tuner.backends.workers.answer import Answer, MakeBackend
from bo_tuner.errors import BackendError, MetricsError
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

EXTRA = "several workers need the packages of the extra: pip install 'bo_tuner[workers]'"
DEATHS = 3
"""Worker processes that may end while they run the same evaluation; then it is lost."""
LOOK_AROUND = 0.1
"""Time [s] after which a wait for results gives way to a signal."""
STARTING = 60.0
"""Time [s] that the processes of the workers have to come up."""
CLOSING = 30.0
"""Time [s] that the backends of the workers have to close; then their processes are ended."""
BREAKING_OFF = 5.0
"""Time [s] of that for one that is to break an evaluation off in process: foreign code looks for no
request."""


class WorkerPool:
    """Runs as many evaluations at once as there are workers.

    A worker is a process with a backend of its own. One that dies is started anew, and what it had
    is run again, on any worker.

    Parameters
    ----------
    name
        Of the backends.
    workers
        Their number.
    make
        Makes the backend of a worker, in its process.
    interrupted
        Asked while waiting; raises what shall end the wait.
    patience
        Time [s] that the backends have to close.
    """

    def __init__(
        self,
        name: str,
        workers: int,
        make: MakeBackend,
        interrupted: Callable[[], None] = lambda: None,
        patience: float = CLOSING,
    ) -> None:
        self.name = name
        self.workers = workers
        self._make = make
        self._interrupted = interrupted
        self._patience = patience
        self._client: Any = None
        self._process: Any = None
        self._stack = contextlib.ExitStack()
        self._running: dict[Any, Evaluation] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def open(self) -> None:
        """Start the workers, and open their backends.

        Raises
        ------
        BackendError
            If Dask is not installed, a process does not come up, or a backend cannot be opened.
        """
        try:
            self._start()
            for answer in self._ask_each(self._process.begin, STARTING):
                if answer.problem:
                    raise BackendError(
                        f"worker {answer.worker} of {self.workers} cannot be started: "
                        f"{answer.problem}"
                    )
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        try:
            # Dask takes its time to be imported, and is there where several workers are wanted.
            from distributed import Client, LocalCluster, Security

            from bo_tuner.backends.workers import process

            # Whoever reaches a scheduler runs code as its user: only who has this run's key does.
            security = Security.temporary()  # type: ignore[no-untyped-call]
        except ImportError as error:
            raise BackendError(f"{EXTRA} ({error.name or error})") from None
        enter = self._stack.enter_context
        try:
            cluster = enter(
                LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=self.workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    # Status pages have ports, too: any free one, of this machine only.
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    worker_dashboard_address="127.0.0.1:0",
                    memory_limit=0,
                    security=security,
                    silence_logs=50,
                )
            )
            cluster.scheduler.allowed_failures = DEATHS - 1
            client = enter(Client(cluster, set_as_default=False))  # type: ignore[no-untyped-call]
            client.wait_for_workers(self.workers, timeout=STARTING)
        except (OSError, TimeoutError, RuntimeError) as error:
            raise BackendError(f"the workers cannot be started: {error}") from error
        client.register_plugin(process.OwnBackend(self._make))
        self._client, self._process = client, process
        self._interrupted()

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run evaluations; yields each as it ends.

        More are taken whenever a worker is free. Where there are no more it ends, after one result
        at least; a later call yields those that still run.

        Raises
        ------
        BackendError
            If a worker that had to be started anew cannot be, or the workers are gone.
        MetricsError
            If a function returns something else than a number for each metric.
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
        future = self._client.submit(self._process.evaluate, planned, pure=False)
        self._running[future.key] = planned
        future.add_done_callback(self._ended.put)

    def _next(self) -> Evaluation:
        """Wait for the next result."""
        while True:
            self._interrupted()
            try:
                future = self._ended.get(timeout=LOOK_AROUND)
            except queue.Empty:
                continue
            planned = self._running.pop(future.key, None)
            if planned is not None:
                return self._result(future, planned)

    def _result(self, future: Any, planned: Evaluation) -> Evaluation:
        from distributed import KilledWorker

        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            reason = f"the process of the worker ended {DEATHS} times while it ran this"
            return replace(planned, outcome=Outcome(EvaluationState.LOST, {}, reason))
        if future.status != "finished":
            # Such as that of an interrupted run, whose signal came meanwhile.
            self._interrupted()
            raise BackendError(f"the workers are gone ({error or future.status})")
        answer: Answer = future.result()
        if answer.evaluation is None:
            self._interrupted()
            if answer.returned:
                raise MetricsError(answer.problem)
            raise BackendError(f"worker {answer.worker}: {answer.problem}")
        return answer.evaluation

    def park(self) -> list[str]:
        """Have each worker set the safe parameters, once its evaluation has ended.

        Returns
        -------
        list of str
            What went wrong, each in a line.
        """
        answers = self._ask_each(self._process.park, None)
        return [
            f"worker {answer.worker}: {problem}"
            for answer in answers
            for problem in (*answer.remarks, *filter(None, [answer.problem]))
        ]

    def _ask_each(self, act: Callable[[], Answer], timeout: float | None) -> Sequence[Answer]:
        """Ask all workers for the same, and wait for their answers."""
        addresses = self._client.scheduler_info(n_workers=-1)["workers"]
        futures = {
            int(str(worker["name"])) + 1: self._client.submit(
                act, pure=False, workers=[address], allow_other_workers=False
            )
            for address, worker in addresses.items()
        }
        deadline = None if timeout is None else time.monotonic() + timeout
        while any(future.status == "pending" for future in futures.values()):
            self._interrupted()
            if deadline is not None and time.monotonic() > deadline:
                break
            time.sleep(LOOK_AROUND)
        return [
            future.result()
            if future.status == "finished"
            else Answer(number, problem=f"its process does not answer ({future.status})")
            for number, future in sorted(futures.items())
        ]

    def close(self) -> None:
        """Break off what runs, close the backends, and end the processes."""
        client, self._client = self._client, None
        self._interrupted = lambda: None
        try:
            if client is not None:
                self._close_backends(client)
        finally:
            self._running.clear()
            self._stack.close()

    def _close_backends(self, client: Any) -> None:
        # What fails here ends with the processes.
        with contextlib.suppress(Exception):
            if self._running:
                client.run(self._process.end)
            self._client = client
            self._ask_each(self._process.close, self._patience)
        self._client = None
