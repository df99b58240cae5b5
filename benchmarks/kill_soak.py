"""100 times kill -9 of plant, controller or tuner at random moments: losses, and time to recover.

A run of the benchmark study over ROS is killed at, in turn, one of its three processes; a killed
tuner is started again by ``tune --resume``, a killed node is the tuner's own business. Before each
kill the journal is read, and again once the next cut is on record: what was there must be there
still, equal in every figure.

Of a killed node, recovery is the time that the lost cut took until its nodes had been replaced and
told their parameters, and the next whole cut. Of a killed tuner it is the time from the kill until
a cut of the next one is on record, which begins with the surrogates. A run that has come to its end
makes place for the next one.

`command_kills.py` kills at what is written at the end of a run, and the other commands.
"""

import contextlib
import os
import signal
import sqlite3
import statistics
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from common import A_RESULT, provenance, result_parser, start_command, table, write_result

from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.study.study_file import load_study, study_to_yaml
from bo_tuner.trials import EvaluationState

SEED = 1
VICTIMS = ("tuner", "milling_plant", "mpc_controller")
LONGEST_WAIT = 180.0
POLL = 0.02


class Tuner:
    """The command ``tune``, which is started again with its run when it has ended."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen | None = None
        self._run: Path | None = None
        self.runs = 0
        self.ended: Counter[str] = Counter()

    def start(self) -> None:
        """Begin a run, or go on with the present one."""
        if self._run is None:
            study = load_study("benchmark").replace(seed=SEED + self.runs)
            study = study.replace(drawn_contexts=3, search_evaluations=2)
            (self._folder / "study.yaml").write_text(study_to_yaml(study))
            arguments = ["--study", "study.yaml", "--output", f"runs-{self.runs}"]
            self.runs += 1
        else:
            arguments = ["--resume", str(self._run)]
        self._process = start_command(self._folder, "tune", *arguments)

    def keep_running(self) -> None:
        """Start what has ended: the same run if it can go on, else the next."""
        code = self._process.poll()
        if code is None:
            return
        if code >= 0:
            self.ended[f"exit code {code}"] += 1
        if code in A_RESULT:
            self._run = None
        self.start()

    @property
    def journal(self) -> Path | None:
        """Journal of the present run, once there is one."""
        if self._run is None:
            found = sorted(self._folder.glob(f"runs-{self.runs - 1}/*/journal.sqlite"))
            self._run = found[0].parent if found else None
        return self._run / "journal.sqlite" if self._run else None

    def record(self) -> RunRecord:
        """Read the present run."""
        if self._run is None:
            raise SystemExit("error: no run has begun")
        return read_run(self._run)

    def whole_evaluations(self) -> int:
        """Count the whole cuts on record."""
        if self.journal is None:
            return 0
        with contextlib.suppress(sqlite3.Error):
            db = sqlite3.connect(f"{self.journal.as_uri()}?mode=ro", uri=True)
            with contextlib.closing(db):
                query = "SELECT count(*) FROM evaluation WHERE state = 'complete'"
                return db.execute(query).fetchone()[0]
        return 0

    def seconds_to_replace(self, evaluations: int) -> float:
        """Add up what lost cuts took after so many evaluations, and the next whole one [s]."""
        total = 0.0
        for recorded in self.record().evaluations[evaluations:]:
            complete = recorded.outcome.state is EvaluationState.COMPLETE
            if not complete or total > 0.0:
                total += recorded.seconds
            if complete and total > 0.0:
                break
        return total

    def pid_of(self, victim: str) -> int | None:
        """Find the process of a victim; None while it has none."""
        if victim == "tuner":
            return self._process.pid
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError, ValueError):
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                command = (folder / "cmdline").read_bytes()
                if parent == self._process.pid and victim.encode() in command:
                    return int(folder.name)
        return None

    def stop(self) -> None:
        """End the run."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.wait()


def wait_for_more_evaluations(tuner: Tuner, count: int) -> None:
    """Wait until more than `count` whole cuts are on record."""
    deadline = time.monotonic() + LONGEST_WAIT
    while tuner.whole_evaluations() <= count:
        if time.monotonic() > deadline:
            raise SystemExit(f"error: no cut for {LONGEST_WAIT:g} s")
        tuner.keep_running()
        time.sleep(POLL)


def missing(before: tuple, after: tuple) -> int:
    """Entries that were there before and are not, or not the same, after."""
    return sum(a != b for a, b in zip(before, after, strict=False)) + max(
        len(before) - len(after), 0
    )


def summary(times: list[float]) -> dict[str, Any]:
    """All of them [s], their median and the longest."""
    if not times:
        return {"seconds": [], "median": None, "worst": None}
    return {"seconds": times, "median": statistics.median(times), "worst": max(times)}


def main() -> None:
    """Kill and report."""
    parser = result_parser(__doc__, "kill_soak.json")
    parser.add_argument("--kills", type=int, default=100, help="(default: %(default)s)")
    arguments = parser.parse_args()
    origin = provenance()
    rng = np.random.default_rng(SEED)
    order = rng.permutation(np.resize(VICTIMS, arguments.kills)).tolist()
    until_next_evaluation: dict[str, list[float]] = {victim: [] for victim in VICTIMS}
    recovery: dict[str, list[float]] = {victim: [] for victim in VICTIMS[1:]}
    lost_evaluations = lost_trials = damaged = seen_evaluations = seen_trials = 0
    with tempfile.TemporaryDirectory() as name:
        tuner = Tuner(Path(name))
        tuner.start()
        try:
            wait_for_more_evaluations(tuner, 0)
            for number, victim in enumerate(order):
                moment = time.monotonic() + rng.uniform(0.0, 2.5)
                while time.monotonic() < moment or (pid := tuner.pid_of(victim)) is None:
                    tuner.keep_running()
                    time.sleep(POLL)
                if tuner.journal is None:  # between two runs
                    wait_for_more_evaluations(tuner, 0)
                run, before = tuner.journal, tuner.record()
                begin = time.perf_counter()
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                while tuner.pid_of(victim) in (pid, None):
                    tuner.keep_running()
                    time.sleep(POLL)
                wait_for_more_evaluations(tuner, tuner.whole_evaluations())
                until_next_evaluation[victim].append(time.perf_counter() - begin)
                if victim != "tuner" and run == tuner.journal:
                    recovery[victim].append(tuner.seconds_to_replace(len(before.evaluations)))
                after = read_run(run.parent)
                lost_evaluations += missing(before.evaluations, after.evaluations)
                lost_trials += missing(before.trials, after.trials)
                damaged += bool(after.damage)
                seen_evaluations += len(before.evaluations)
                seen_trials += len(before.trials)
                print(f"{number} {victim}: {until_next_evaluation[victim][-1]:.2f} s", flush=True)
        finally:
            tuner.stop()
    result: dict[str, Any] = {
        "provenance": origin,
        "seed": SEED,
        "kills": dict(Counter(order)),
        "runs": tuner.runs,
        "ended_by_itself": dict(tuner.ended),
        "cuts_on_record_at_a_kill": seen_evaluations,
        "trials_on_record_at_a_kill": seen_trials,
        "lost_cuts": lost_evaluations,
        "lost_trials": lost_trials,
        "damaged_journals": damaged,
        "load_average": os.getloadavg(),
        "recovery": {victim: summary(times) for victim, times in recovery.items()},
        "until_next_cut": {
            victim: summary(times) for victim, times in until_next_evaluation.items()
        },
    }
    write_result(arguments.result, result)
    rows = [
        [f"{what}, {victim} killed", len(figures["seconds"]), figures["median"], figures["worst"]]
        for what in ("recovery", "until_next_cut")
        for victim, figures in result[what].items()
        if figures["seconds"]
    ]
    print(table(["what", "times", "median [s]", "worst [s]"], rows))
    print(f"lost cuts: {lost_evaluations}, lost trials: {lost_trials}, damaged journals: {damaged}")


if __name__ == "__main__":
    main()
