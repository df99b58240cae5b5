"""The load of a run, from what a system says of its processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import wait_until

from bo_tuner.processor_load import Load, LoadMeter, with_children

SPIN = "import os\nos.sched_setaffinity(0, {%d})\nwhile True: pass"


class Proc:
    """A system that says so many microseconds of pressure, and of tasks ran and waited [ns]."""

    def __init__(self, folder):
        self.folder = folder

    def says(self, pressure, **tasks):
        if pressure is not None:
            path = self.folder / "pressure/cpu"
            path.parent.mkdir(exist_ok=True)
            path.write_text(
                f"some avg10=0.00 avg60=0.00 avg300=0.00 total={pressure}\nfull total=7\n"
            )
        for task, (ran, waited) in tasks.items():
            folder = self.folder / "7/task" / task.removeprefix("t")
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "schedstat").write_text(f"{ran} {waited} 3\n")


@pytest.fixture
def proc(tmp_path):
    return Proc(tmp_path)


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("bo_tuner.processor_load.time.monotonic", lambda: now[0])
    return now


def test_the_shares_are_of_the_run_alone(proc, clock):
    proc.says(5_000_000, t7=(10**9, 10**9))
    meter = LoadMeter([7], proc.folder)
    clock[0] += 2.0
    # 0.5 s of 2 s; of 4 s that were wanted 1 s was waited for, in a task that is new, too.
    proc.says(5_500_000, t7=(3 * 10**9, 15 * 10**8), t8=(10**9, 5 * 10**8))
    assert meter.load([7]) == Load(0.25, 0.25)


@pytest.mark.parametrize(
    ("pressure", "tasks", "expected"),
    [
        (None, {"t7": (4, 4)}, Load(None, 0.5)),
        (1_000_000, {}, Load(1.0, None)),
        (None, {}, Load(None, None)),
        # Another clock: more than all of the time.
        (9_000_000, {"t7": (0, 4)}, Load(1.0, 1.0)),
    ],
)
def test_what_a_system_does_not_say_is_absent(proc, clock, pressure, tasks, expected):
    proc.says(None if pressure is None else 0, **dict.fromkeys(tasks, (0, 0)))
    meter = LoadMeter([7, 4711], proc.folder)
    clock[0] += 1.0
    proc.says(pressure, **tasks)
    assert meter.load([7, 4711]) == expected


@pytest.mark.parametrize("text", ["", "some", "some total=", "full total=3", "some total=x"])
def test_a_pressure_that_cannot_be_read_is_absent(proc, text):
    proc.says(1)
    (proc.folder / "pressure/cpu").write_text(text)
    assert LoadMeter([], proc.folder).load([]).machine is None


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan"), float("inf")])
def test_a_load_is_a_share(share):
    for shares in ((share, None), (None, share)):
        with pytest.raises(ValueError, match="expected a share from 0 to 1"):
            Load(*shares)


needs_linux = pytest.mark.skipif(
    not Path("/proc/self/schedstat").exists(), reason="the system does not say it"
)


@needs_linux
def test_two_that_want_one_processor_wait_half_of_the_time():
    """By the definition of a fair scheduler; beside a third one, for longer."""
    processor = min(os.sched_getaffinity(0))
    spinning = [subprocess.Popen([sys.executable, "-c", SPIN % processor]) for _ in range(2)]
    try:
        wait_until(
            lambda: all(os.sched_getaffinity(p.pid) == {processor} for p in spinning), "affinity"
        )
        meter = LoadMeter([p.pid for p in spinning])
        time.sleep(1.0)
        load = meter.load([p.pid for p in spinning])
    finally:
        for process in spinning:
            process.kill()
            process.wait()
    assert load.nodes > 0.4
    assert load.machine is None or load.machine > 0.4


@needs_linux
def test_what_a_process_has_started_counts():
    """Such as a node behind a shell script."""
    shell = subprocess.Popen(["/bin/sh", "-c", "sleep 60 & wait"], start_new_session=True)
    try:
        wait_until(lambda: len(list(with_children([shell.pid]))) == 2, "the child")
        assert set(with_children([shell.pid])) < set(with_children([os.getpid()]))
    finally:
        os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
