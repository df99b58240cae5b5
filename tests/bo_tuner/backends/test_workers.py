"""A pool of workers, by itself."""

import os
import time
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import pytest
from functions import planned

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.backends.workers import pool as pool_module
from bo_tuner.backends.workers import process
from bo_tuner.backends.workers.clusters import DEATHS
from bo_tuner.backends.workers.pool import WorkerPool
from bo_tuner.errors import BackendError, RunError
from bo_tuner.trials import EvaluationState, Outcome

FIRST, LAST, DEADLY, BROKEN = 0, 1, 2, 3


class Odd(SequentialBackend):
    """Does what the seed of an evaluation says; its outcome has the number of the worker."""

    name = "odd"
    heard = None

    def __init__(self, study, folder, number, host_folder, interrupted):
        super().__init__(study)
        self._folder, self._number = folder, number

    def open(self):
        (self._folder / f"open-{self._number}").touch()

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
        self.heard = f"{planned.seed} of {planned.index}"
        return Outcome(EvaluationState.COMPLETE, {"error": float(self._number), "peak": 0.1})


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


class Deserted:
    """In place of a connection to a cluster whose workers have all gone."""

    key = "never"
    status = "running"
    scheduler = None

    def submit(self, *_arguments, **_options):
        return self

    def add_done_callback(self, _call):
        pass


def test_workers_that_do_not_come_back_are_not_waited_for(monkeypatch):
    for name in ("LEFT_ALONE", "LOOK_FOR_WORKERS"):
        monkeypatch.setattr(f"bo_tuner.backends.workers.pool.{name}", 0.0)
    pool = WorkerPool("odd", 2, Odd)
    pool._client, pool._process = Deserted(), process
    with pytest.raises(RunError, match="there has been no worker for"):
        list(pool.run([doing(FIRST, 0)]))


def test_workers_that_are_killed_while_they_get_ready_are_named(monkeypatch):
    """Dask tells of it as of a connection that was closed."""

    class Killed:
        status = "closed"

        def register_plugin(self, plugin):
            raise ConnectionResetError("Stream is closed")

    monkeypatch.setattr(pool_module, "local_cluster", lambda count: nullcontext(Killed()))
    pool = WorkerPool("odd", 2, Odd)
    with pytest.raises(BackendError, match=r"^the workers are gone \(Stream is closed\)$"):
        pool.open()
