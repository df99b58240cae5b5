"""Execution of tasks, several at a time, and a record of each as it ends."""

import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import joblib  # type: ignore[import-untyped]
from joblib.externals.loky import get_reusable_executor  # type: ignore[import-untyped]
from joblib.externals.loky.process_executor import (  # type: ignore[import-untyped]
    ShutdownExecutorError,
)

from bo_tuner.errors import BackendError, RunError
from bo_tuner.interruption import Interruption
from tuning_benchmark.campaign.records import Records
from tuning_benchmark.campaign.tasks import Task, carry_out

POLL = 0.2
"""Time [s] after which a signal is noticed."""

THREAD = "tasks"
"""Name of the thread that waits for the tasks; with one process, it carries them out."""

CUT_OFF = 10
"""Time [s] that the thread has to end once its processes have been ended."""

CONNECTING = 10
"""Time [s] that a cluster has to answer."""


def conduct(
    tasks: Sequence[Task],
    records: Records,
    interruption: Interruption,
    *,
    jobs: int,
    cluster: str,
    about: Mapping[str, str],
    tell: Callable[[dict[str, Any]], None],
) -> None:
    """Carry out the tasks that are not on record yet, and once more those that failed.

    Parameters
    ----------
    tasks
        All tasks of the campaign.
    records
        Open; each task is recorded as soon as it ends.
    interruption
        Ends the campaign on a signal.
    jobs
        Processes on this machine.
    cluster
        Address of a Dask scheduler; its workers run the tasks instead. Empty for none.
    about
        Provenance that all records share.
    tell
        Called with each new record.

    Raises
    ------
    BackendError
        If the cluster is not available, or its workers have several threads.
    RunError
        If a process of the campaign died, or cannot run a task.
    Interrupted
        On a signal. Finished tasks are on record.
    """
    missing = unfinished(tasks, records)
    if not missing:
        return
    with _client(cluster) as client:
        config: dict[str, Any] = {
            "backend": "loky",
            "n_jobs": jobs,
            "inner_max_num_threads": 1,
            "initializer": _start_worker,
            "initargs": (os.getpid(),),
        }
        if client is not None:
            config = {"backend": "dask", "client": client}
        try:
            for record in _results(missing, interruption, config):
                records.add(record | {"about": {**about, **record["about"]}})
                tell(record)
        except BaseException:
            if client is None and jobs > 1:
                logging.getLogger("concurrent.futures").addFilter(_is_no_late_task)
                # They would go on with tasks whose results are not used any more. Reused: another
                # one would wait for them, with a lock held that they need for their next task.
                get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
                _join()
            raise


def _is_no_late_task(record: logging.LogRecord) -> bool:
    """Whether it is not what a process that has ended its task says of the next one, too late."""
    return not (record.exc_info and isinstance(record.exc_info[1], ShutdownExecutorError))


def unfinished(tasks: Sequence[Task], records: Records) -> list[Task]:
    """List the tasks without a record, and those that failed."""
    whole = {name for name, record in records.done.items() if not record["failed"]}
    return [task for task in tasks if task.name not in whole]


def at_work() -> bool:
    """Whether a task may still run in this process, after an interruption."""
    return bool(_threads())


def _results(
    tasks: Sequence[Task], interruption: Interruption, config: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Yield records as tasks end; the wait for the next one gives way to a signal."""
    results: queue.Queue[dict[str, Any] | Exception | None] = queue.Queue()

    def work() -> None:
        try:
            # What is configured holds for the thread that configures it.
            with joblib.parallel_config(**config):
                parallel = joblib.Parallel(
                    return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs"
                )
                for record in parallel(joblib.delayed(carry_out)(task) for task in tasks):
                    results.put(record)
            results.put(None)
        except Exception as error:
            results.put(error)

    thread = threading.Thread(target=work, name=THREAD, daemon=True)
    thread.start()
    while True:
        interruption.check()
        try:
            item = results.get(timeout=POLL)
        except queue.Empty:
            continue
        if not isinstance(item, dict):
            thread.join()
        if item is None:
            return
        if isinstance(item, Exception):
            name = "" if isinstance(item, RunError) else f"{type(item).__name__}: "
            problem = " ".join(f"{name}{item}".split())[:300]
            raise RunError(f"the campaign was aborted: {problem}") from item
        yield item


def _join() -> None:
    """Wait until the tasks that have been cut off have ended here too.

    A process that ended before would leave semaphores and folders behind, and joblib would warn
    of them on the terminal, after the last line of the campaign.
    """
    for thread in _threads():
        thread.join(CUT_OFF)


def _threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == THREAD]


def _start_worker(parent: int) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process once its parent was killed, as its results are not used any more."""
    while os.getppid() == parent:
        time.sleep(POLL)
    os._exit(1)


@contextmanager
def _client(cluster: str) -> Iterator[Any]:
    """Connect to a Dask scheduler; to none without an address."""
    if not cluster:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise BackendError(
            "--cluster needs the package distributed: pip install 'distributed>=2024.8'"
        ) from None
    address = "tcp://" + cluster.partition("://")[2]
    try:
        client = Client(  # type: ignore[no-untyped-call]
            address, timeout=CONNECTING, set_as_default=False
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise BackendError(f"{cluster}: no Dask scheduler answers there: {error}") from error
    with client:
        threads = client.scheduler_info(n_workers=-1)["workers"].values()
        if any(worker["nthreads"] > 1 for worker in threads):
            raise BackendError(
                f"{cluster}: expected workers of one thread, for optimizers draw from the random "
                "numbers of their process; start them with `dask worker --nthreads 1`"
            )
        yield client
