"""A pool of workers, by itself."""

import os
import signal
import socket
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import psutil
import pytest
from functions import planned
from waiting import wait_until

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.backends.workers import pool as pool_module
from bo_tuner.backends.workers import process
from bo_tuner.backends.workers.answer import Answer
from bo_tuner.backends.workers.clusters import DEATHS
from bo_tuner.backends.workers.pool import WorkerPool
from bo_tuner.errors import BackendError, RunError
from bo_tuner.trials import EvaluationState, Outcome

FIRST, LAST, DEADLY, BROKEN, STOPPED, DIES_LATER = range(6)


class Odd(SequentialBackend):
    """Does what the seed of an evaluation says; its outcome has the number of the worker."""

    name = "odd"
    heard = None

    def __init__(self, study, folder, number, host_folder, interrupted):
        super().__init__(study)
        self._folder, self._number = folder, number

    def open(self):
        if (self._folder / "kill-first").exists() and self._number == 2:
            kill_once_known(self._folder / "open-1")
        (self._folder / f"open-{self._number}").write_text(str(os.getpid()))

    def close(self):
        (self._folder / f"open-{self._number}").unlink()

    def park(self):
        return [f"{self._number} does not park"]

    def outcome(self, planned):
        if planned.seed == DEADLY:
            with (self._folder / "deaths").open("a") as file:
                file.write("x")
            os.kill(os.getpid(), 9)
        if planned.seed == BROKEN:
            raise BackendError("the bus is gone")
        if planned.seed == LAST:
            while not (self._folder / "go").exists():
                time.sleep(0.01)
        first = not (self._folder / "first").exists()
        (self._folder / "first").write_text(str(os.getpid()))
        if planned.seed == STOPPED and first:
            os.kill(os.getpid(), signal.SIGSTOP)
        if planned.seed == DIES_LATER and not first:
            # For so long its first result is known to be lost.
            time.sleep(1.0)
        self.heard = f"{planned.seed} of {planned.index}"
        return Outcome(EvaluationState.COMPLETE, {"error": float(self._number), "peak": 0.1})


def kill_once_known(file):
    """End the process of a file, once Dask knows what it has done."""
    wait_until(lambda: file.exists() and file.read_text(), "a process")
    time.sleep(0.5)
    os.kill(int(file.read_text()), signal.SIGKILL)


@pytest.fixture
def pool(make_study, tmp_path):
    pool = WorkerPool("odd", 2, partial(Odd, make_study(), tmp_path))
    pool.open()
    yield pool
    pool.close()


def doing(seed, index):
    return replace(planned({"gain": 0.5}, {"load": 1.5}, seed), index=index)


def test_results_come_as_they_end_and_more_is_taken_when_a_worker_is_free(pool, tmp_path):
    taken = []

    def due():
        for index, seed in enumerate((LAST, FIRST, FIRST)):
            taken.append(index)
            yield doing(seed, index)

    results = pool.run(due())
    # The first is held: the other worker has all others, one after the other.
    assert next(results).index == 1
    assert taken == [0, 1]
    assert next(results).index == 2
    assert taken == [0, 1, 2]
    # What is taken meanwhile does not wait for it either.
    assert [evaluation.index for evaluation in pool.run([doing(FIRST, 3)])] == [3]
    (tmp_path / "go").touch()
    (last,) = pool.run([])
    assert last.index == 0
    assert list(pool.run([])) == []
    assert pool.park() == ["worker 1: 1 does not park", "worker 2: 2 does not park"]
    assert {path.name for path in tmp_path.glob("open-*")} == {"open-1", "open-2"}
    pool.close()
    assert not [*tmp_path.glob("open-*")]
    with pytest.raises(BackendError, match="not open"):
        next(pool.run([doing(FIRST, 4)]))


def test_what_a_backend_has_heard_comes_with_the_result_once(pool):
    (done,) = pool.run([doing(FIRST, 7)])
    answer = pool.take_answer()
    assert (answer.heard, answer.evaluation) == ("0 of 7", done)
    assert float(answer.worker) == done.outcome.metrics["error"]
    assert pool.take_answer() is None


def test_an_evaluation_that_ends_each_worker_is_lost(pool, tmp_path):
    list(pool.run([doing(FIRST, 2)]))
    (lost,) = pool.run([doing(DEADLY, 0)])
    assert pool.take_answer() is None
    assert lost.outcome.state is EvaluationState.LOST
    assert len((tmp_path / "deaths").read_text()) == DEATHS
    (other,) = pool.run([doing(FIRST, 1)])
    assert other.outcome.complete


def test_a_backend_that_cannot_go_on_ends_the_run_and_is_named(pool):
    with pytest.raises(RunError, match=r"worker [12]: the bus is gone"):
        list(pool.run([doing(BROKEN, 0)]))


class TestAbsent:
    """Workers that die, or stand still, at any moment."""

    def test_one_that_dies_with_its_result(self, pool, tmp_path):
        def due():
            yield doing(DIES_LATER, 0)
            kill_once_known(tmp_path / "first")
            yield doing(FIRST, 1)

        results = {evaluation.index: evaluation.outcome for evaluation in pool.run(due())}
        results |= {evaluation.index: evaluation.outcome for evaluation in pool.run([])}
        assert results[0].complete
        assert results[1].complete

    def test_one_that_dies_while_another_begins(self, make_study, tmp_path):
        (tmp_path / "kill-first").touch()
        pool = WorkerPool("odd", 2, partial(Odd, make_study(), tmp_path))
        pool.open()
        try:
            (done,) = pool.run([doing(FIRST, 0)])
            assert done.outcome.complete
        finally:
            pool.close()

    def test_one_that_is_stopped(self, pool, tmp_path, monkeypatch):
        """Another runs what it had; in the end none is waited for."""
        for name in ("LEFT_ALONE", "LOOK_FOR_WORKERS"):
            monkeypatch.setattr(f"bo_tuner.backends.workers.pool.{name}", 0.0)
        (done,) = pool.run([doing(STOPPED, 0)])
        assert done.outcome.complete
        pids = [int(path.read_text()) for path in tmp_path.glob("open-*")]
        for pid in filter(psutil.pid_exists, pids):
            os.kill(pid, signal.SIGSTOP)
        pool.close()
        assert not any(map(psutil.pid_exists, pids))


def test_pages_of_tasks_are_served_to_nobody(make_study, tmp_path):
    before = listening([os.getpid()])
    pool = WorkerPool("odd", 2, partial(Odd, make_study(), tmp_path))
    pool.open()
    try:
        pids = [int(path.read_text()) for path in tmp_path.glob("open-*")]
        ports = listening([os.getpid(), *pids]) - before
        assert len(ports) >= len(pids)
        for port in ports:
            assert not answer_to_http(port).startswith(b"HTTP")
    finally:
        pool.close()


def listening(pids):
    """Return the TCP ports of processes."""
    connections = (c for pid in pids for c in psutil.Process(pid).net_connections("tcp"))
    return {c.laddr.port for c in connections if c.status == psutil.CONN_LISTEN}


def answer_to_http(port):
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        connection.sendall(b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n")
        try:
            return connection.recv(100)
        except ConnectionError:
            return b""


class Unheard:
    """In place of a result: it was there, and does not come."""

    def __init__(self, key, status, answer=None):
        self.key, self.status, self._answer = key, status, answer

    def add_done_callback(self, call):
        call(self)

    def result(self):
        if self._answer is None:
            threading.Event().wait()
        return self._answer


class Unheeding:
    """In place of a connection."""

    status = "running"
    cluster = None

    def __init__(self, *futures):
        self._futures = list(futures)

    def submit(self, *_arguments, **_options):
        return self._futures.pop(0)


@pytest.fixture
def alone(monkeypatch):
    """A pool of one worker, which is known to be there, with given results."""
    monkeypatch.setattr(pool_module, "workers_of", lambda _client, _interrupted: {"a": {"name": 0}})

    def make(*futures, interrupted=lambda: None):
        pool = WorkerPool("odd", 1, Odd, interrupted)
        pool._client, pool._process = Unheeding(*futures), process
        return pool

    return make


def test_a_result_that_does_not_come_is_not_waited_for(alone, monkeypatch):
    monkeypatch.setattr(pool_module, "LEFT_ALONE", 0.2)
    evaluation = doing(FIRST, 0)
    futures = [Unheard("stuck", "finished"), Unheard("lost", "lost")]
    pool = alone(*futures, Unheard("there", "finished", Answer("1", evaluation)))
    assert list(pool.run([evaluation])) == [evaluation]


def test_a_signal_is_heard_while_a_result_does_not_come(alone):
    class Stop(BaseException):
        pass

    def interrupted():
        raise Stop

    with pytest.raises(Stop):
        list(alone(Unheard("stuck", "finished"), interrupted=interrupted).run([doing(FIRST, 0)]))


def test_one_that_dies_once_it_has_answered_has_done_what_it_was_asked_for(alone):
    assert alone(Unheard("gone", "lost")).park() == []


class Deserted:
    """In place of a connection to a cluster whose workers have all gone."""

    key = "never"
    status = "running"
    scheduler = None
    cluster = None

    def submit(self, *_arguments, **_options):
        return self

    def add_done_callback(self, _call):
        pass


def test_workers_that_do_not_come_back_are_not_waited_for(monkeypatch):
    for name in ("LEFT_ALONE", "LOOK_FOR_WORKERS"):
        monkeypatch.setattr(f"bo_tuner.backends.workers.pool.{name}", 0.0)
    pool = WorkerPool("odd", 2, Odd)
    pool._client, pool._process = Deserted(), process
    with pytest.raises(RunError, match="no worker has been heard of for"):
        list(pool.run([doing(FIRST, 0)]))


def test_a_scheduler_that_stands_still_is_not_waited_for_beyond_a_request(monkeypatch):
    monkeypatch.setattr(pool_module, "LOOK_FOR_WORKERS", 0.0)
    never, asked = threading.Event(), threading.Event()

    class Silent(Deserted):
        scheduler = SimpleNamespace(identity=None)

        def sync(self, *_arguments, **_options):
            asked.set()
            never.wait()

    class Stop(BaseException):
        pass

    def interrupted():
        if asked.is_set():
            raise Stop

    pool = WorkerPool("odd", 2, Odd, interrupted)
    pool._client, pool._process = Silent(), process
    with pytest.raises(Stop):
        list(pool.run([doing(FIRST, 0)]))
    never.set()


def test_workers_that_are_killed_while_they_get_ready_are_named(monkeypatch):
    """Dask tells of it as of a connection that was closed."""

    class Killed:
        status = "closed"

        def register_plugin(self, plugin):
            raise ConnectionResetError("Stream is closed")

    monkeypatch.setattr(pool_module, "local_cluster", lambda *_: nullcontext(Killed()))
    pool = WorkerPool("odd", 2, Odd)
    with pytest.raises(BackendError, match=r"^the workers are gone \(Stream is closed\)$"):
        pool.open()
