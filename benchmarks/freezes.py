"""Tuner, guard and node are off the processor at random: how long until the machine is stopped.

In a run of ``tune --attach`` on ``examples/unchanged_system`` the tuner, and at random its guard
and the node that is tuned, are stopped for 0.2 to 30 s each, and let go on. Where the tuner is off
for longer than a guard waits for it, a stop message is due as soon as tuner or guard lives: the
time is taken from then on. Where all of them were off for longer than the lease of ROS, they first
have to discover each other anew.
"""

import argparse
import contextlib
import multiprocessing
import os
import signal
import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from busy_computer import busy
from common import provenance, result_parser, table, write_result
from guard_faults import (
    KILLED,
    LONGEST,
    Observer,
    guards,
    machine,
    start_of,
    the_study,
    wait_for,
    wait_for_guards,
)

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import isolated_environment
from bo_tuner.errors import BackendError
from bo_tuner.trials import Evaluation, Stage

SHORTEST, LONGEST_FREEZE = 0.2, 30.0
PATIENCE = 1.5
"""Time [s] after which a guard has acted on a tuner that is silent, on a busy computer too."""
LEASE = 2.0
"""Time [s] after which ROS takes a process for dead, by the profile of the tests."""
SEED = 1
LOADS = (0, 8)
"""Numbers of busy programs beside them."""
WITHIN, BEYOND = "within the lease", "beyond the lease"


def work(folder: str) -> None:
    """Be a tuner that makes runs until it cannot go on."""
    os.setsid()
    backend = RosBackend(
        the_study(KILLED), Path(folder), attach=True, guard=True, halt=lambda text: None
    )
    index = 0
    try:
        backend.open()
        while True:
            parameters = {"kp": 2.0, "ki": 0.0, "kd": 0.1}
            backend.outcome(Evaluation(0, index, Stage.DRAWN, parameters, {}, index))
            index += 1
    except BackendError as error:
        print(error, file=sys.stderr)
    finally:
        backend.close()


def freeze(spans: dict[int, tuple[float, float]]) -> tuple[float, dict[int, tuple[float, float]]]:
    """Stop processes for their spans of time [s] from now on; returns now, and when they were."""
    begun = time.monotonic()
    acts = sorted(
        [(start, pid, signal.SIGSTOP) for pid, (start, _) in spans.items()]
        + [(end, pid, signal.SIGCONT) for pid, (_, end) in spans.items()]
    )
    done: dict[int, list[float]] = {pid: [] for pid in spans}
    for when, pid, signum in acts:
        time.sleep(max(begun + when - time.monotonic(), 0.0))
        # A guard of a tuner that has ended ends, too.
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signum)
        done[pid].append(time.monotonic())
    return begun, {pid: (times[0], times[1]) for pid, times in done.items()}


def alive_at(frozen: dict[int, tuple[float, float]], pids: tuple[int, int], after: float) -> float:
    """Return the first time from `after` on at which one of two processes is on the processor."""
    return min(
        end if start <= after < end else after
        for start, end in (frozen.get(pid, (0.0, 0.0)) for pid in pids)
    )


def trial(observer: Observer, node: int, rng: np.random.Generator) -> dict[str, Any] | None:
    """Make one schedule of freezes; returns what it was, and how long the machine went on.

    None if the tuner did not come to a run, as on a computer that is too busy to discover nodes.
    """
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        observer.forget()
        tuner = spawn.Process(target=work, args=(folder,), daemon=True)
        tuner.start()
        try:
            start_of(2, observer, tuner)
        except SystemExit as error:
            print(error, file=sys.stderr)
            tuner.kill()
            tuner.join()
            wait_for_guards(folder)
            return None
        (guard,) = guards(folder)
        spans = {}
        for pid, share in ((tuner.pid or 0, 1.0), (guard, 0.7), (node, 0.3)):
            if rng.random() < share:
                begin = float(rng.uniform(0.05, 0.8))
                length = float(np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST_FREEZE))))
                spans[pid] = (begin, begin + length)
        _, frozen = freeze(spans)
        off, on = frozen[tuner.pid or 0]
        found: dict[str, Any] = {"off": {}}
        names = {tuner.pid: "tuner", guard: "guard", node: "node"}
        for pid, (start, end) in frozen.items():
            found["off"][names[pid]] = [round(start - off, 3), round(end - off, 3)]
        if on - off > PATIENCE:
            due = alive_at(frozen, (tuner.pid or 0, guard), off + PATIENCE)
            found["discovery"] = due - off > LEASE
            found["seconds"] = max(observer.first("stop", off) - due, 0.0)
        # Whatever came of it, the machine is safe once nobody tunes it.
        tuner.terminate()
        tuner.join(LONGEST)
        tuner.kill()
        tuner.join()
        wait_for_guards(folder)
        found["left unsafe"] = not observer.heard("safe")
        if not wait_for(observer.is_alone):
            raise SystemExit("error: a tuner that was killed is in the graph still")
        return found


def series(job: int, jobs: int, arguments: argparse.Namespace) -> list[dict[str, Any] | None]:
    """Make the schedules of one job, in its own ROS domain, until the time is over."""
    os.environ.update(isolated_environment(arguments.domain + job))
    until = time.monotonic() + 60.0 * arguments.minutes
    rng = np.random.default_rng([SEED, job])
    made: list[dict[str, Any] | None] = []
    with tempfile.TemporaryDirectory() as state, machine() as (_, pid):
        os.environ["XDG_STATE_HOME"] = state
        observer = Observer()
        try:
            while len(made) * jobs + job < arguments.schedules and time.monotonic() < until:
                made.append(trial(observer, pid.pid, rng))
        finally:
            observer.close()
    return made


def figures(found: list[dict[str, Any]], discovery: bool) -> dict[str, Any] | None:
    """Return how long the machine went on after a stop message was due; None if it never was."""
    seconds = [f["seconds"] for f in found if f.get("discovery") is discovery]
    if not seconds:
        return None
    return {
        "schedules": len(seconds),
        "within 2 s": sum(s <= 2.0 for s in seconds),
        "median": statistics.median(seconds),
        "worst": max(seconds),
    }


def main() -> None:
    """Make the schedules and write the result."""
    parser = result_parser(__doc__ or "", "freezes.json")
    parser.add_argument("--schedules", type=int, default=200, help="schedules of freezes")
    parser.add_argument("--minutes", type=float, default=60.0, help="the longest time of each load")
    parser.add_argument("--jobs", type=int, default=1, help="schedules at once")
    parser.add_argument("--loads", type=int, nargs="+", default=LOADS, help="busy programs beside")
    parser.add_argument("--domain", type=int, default=88, help="ROS domain of the first of them")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"provenance": provenance(), "seed": SEED, "jobs": arguments.jobs}
    rows = []
    for load in arguments.loads:
        spawn = multiprocessing.get_context("spawn")
        with busy(load), ProcessPoolExecutor(arguments.jobs, spawn) as pool:
            numbers = range(arguments.jobs)
            jobs = [pool.submit(series, k, arguments.jobs, arguments) for k in numbers]
            made = [schedule for job in jobs for schedule in job.result()]
        found = [schedule for schedule in made if schedule is not None]
        row: dict[str, Any] = {
            "schedules": found,
            "not begun": len(made) - len(found),
            "left unsafe": sum(f["left unsafe"] for f in found),
            "load_average": os.getloadavg(),
        }
        for name, discovery in ((WITHIN, False), (BEYOND, True)):
            if (row_of := figures(found, discovery)) is not None:
                row[name] = row_of
                rows.append([load, name, *row_of.values()])
        result[f"beside {load}"] = row
        write_result(arguments.result, result)
    header = ["busy programs", "off", "schedules", "within 2 s", "median [s]", "worst"]
    print(table(header, rows))


if __name__ == "__main__":
    main()
