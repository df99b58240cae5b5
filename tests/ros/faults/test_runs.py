"""Runs that are cut short, by a kill or a full disk, and go on; a wall clock that jumps."""

import dataclasses
import functools
import json
import random
import resource
import signal
import subprocess
import sys
import time

import pytest
from commands import Fork, environment, python_path, start
from short_cuts import small_study
from waiting import DEADLINE, wait_until

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.isolation import PROFILE_VARIABLES
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.registry import METHODS
from bo_tuner.run_notes import Notes
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import EvaluationState, TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

pytestmark = [pytest.mark.ros, pytest.mark.slow]

# What the tuner sets by itself.
OWN = ("ROS_DOMAIN_ID", *PROFILE_VARIABLES, "ROS_AUTOMATIC_DISCOVERY_RANGE")


def study_of(trials=7):
    """The benchmark without any measured time, so that the backends agree bit for bit."""
    return small_study(
        trials,
        controller={"return_time": "modelled"},
        initial_trials=min(trials, 5),
        search_evaluations=1,
        validation_draws=1,
    )


@functools.cache
def uninterrupted(trials=7):
    """Trials of a run of `study_of` without ROS and without faults."""
    study = study_from_mapping(study_of(trials))
    backend = InProcessBackend(study)
    backend.open()
    return tuple(Tuning(study, Driver(backend), METHODS[DEFAULT_METHOD]))


def figures(trials):
    """All of trials but what only nodes tell of their evaluations, such as when they ran."""
    plain = []
    for trial in trials:
        outcomes = [
            dataclasses.replace(evaluation.outcome, details={}, notes=Notes())
            for evaluation in trial.evaluations
        ]
        pairs = zip(trial.evaluations, outcomes, strict=True)
        evaluations = tuple(
            dataclasses.replace(evaluation, outcome=outcome) for evaluation, outcome in pairs
        )
        plain.append(dataclasses.replace(trial, evaluations=evaluations))
    return plain


class Run:
    """A run in a folder, and the command that is at work on it."""

    def __init__(self, folder, study, output="runs", **changes):
        self.folder = folder
        self.output = folder / output
        (folder / "study.yaml").write_text(json.dumps(study))
        self._changes = {"HOME": str(folder)} | changes
        # What Python reads at its start is for an interpreter of its own.
        self._start = start if "PYTHONPATH" in changes else Fork
        self.process = None

    def start(self):
        self._tune("--study", "study.yaml", "--output", str(self.output), "--record", "none")

    def resume(self):
        self._tune("--resume", str(self.output / "latest"), "--record", "none")

    def _tune(self, *arguments):
        with (self.folder / "out").open("a") as out:
            self.process = self._start(
                "tune",
                *arguments,
                folder=self.folder,
                env=self._changes,
                without=OWN,
                stdout=out,
                stderr=out,
            )

    @property
    def said(self):
        return (self.folder / "out").read_text()

    def record(self):
        return read_run(self.output / "latest")

    def wait_for(self, condition, what):
        wait_until(condition, what, self.process, lambda: self.said)

    def wait_for_evaluations(self, count):
        """Wait until more evaluations than `count` are on record."""
        latest = self.output / "latest" / "journal.sqlite"
        self.wait_for(
            lambda: latest.exists() and len(self.record().evaluations) > count, "more evaluations"
        )

    def wait_for_trials(self, count):
        self.wait_for(lambda: len(self.record().trials) >= count, f"{count} trials")

    def interrupt(self):
        """End it as by Ctrl-C, unless it ends by itself just then.

        What follows the trials takes long, and is tested elsewhere.
        """
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(DEADLINE) in (0, 3, 130), self.said
        assert "Traceback" not in self.said, self.said

    def close(self):
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(DEADLINE)


@pytest.fixture
def make_run(tmp_path):
    runs = []

    def make(*arguments, **options):
        runs.append(Run(tmp_path, *arguments, **options))
        return runs[-1]

    yield make
    for run in runs:
        run.close()


def starts_with(record, before):
    """Whether a record holds all of an earlier one, unchanged."""
    return (
        record.evaluations[: len(before.evaluations)] == before.evaluations
        and record.trials[: len(before.trials)] == before.trials
        and not record.damage
    )


def test_a_tuner_killed_again_and_again_comes_to_the_same_trials(make_run):
    """Killed at any moment, in an evaluation or in thought; nothing on record is lost."""
    study = study_of()
    run = make_run(study)
    rng = random.Random(2)
    run.start()
    for evaluations in (4, 8, 12):
        # Counted, since a quick machine ends the run within a second or two of its start.
        run.wait_for_evaluations(evaluations)
        time.sleep(rng.uniform(0.0, 0.1))
        before = run.record()
        run.process.kill()
        run.process.wait()
        assert starts_with(run.record(), before)
        run.resume()
    run.wait_for_trials(study["budget"]["trials"])
    run.interrupt()
    assert figures(run.record().trials) == figures(uninterrupted())


def limit_file_size(run):
    """No file of the tuner may grow beyond what its journal has now."""
    (log,) = run.output.glob("latest/journal.sqlite-wal")
    limit = log.stat().st_size + 100
    resource.prlimit(run.process.pid, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))


def test_a_file_that_may_not_grow_ends_the_run_so_that_it_goes_on(make_run):
    study = study_of()
    run = make_run(study)
    run.start()
    run.wait_for_evaluations(3)
    limit_file_size(run)
    before = run.record()
    assert run.process.wait(DEADLINE) == 1, run.said
    assert "Traceback" not in run.said
    last = run.said.splitlines()[-1]
    assert last.startswith("error: ")
    assert "journal.sqlite" in last
    assert "resume it with: tune --resume" in last
    assert starts_with(run.record(), before)
    run.resume()
    run.wait_for_trials(study["budget"]["trials"])
    run.interrupt()
    assert figures(run.record().trials) == figures(uninterrupted())


CLOCK = """\
import random
import time
real = time.time
# By up to twelve days forth or back, at each look.
time.time = lambda: real() + random.uniform(-1e6, 1e6)
time.time_ns = lambda: int(time.time() * 1e9)
"""


def test_no_wall_clock_decides_anything(make_run, tmp_path):
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(CLOCK)
    study = study_of(trials=4)
    run = make_run(study, PYTHONPATH=python_path(folder))
    jumps = "import time; a = time.time(); print(any(abs(time.time() - a) > 1e3 for _ in range(9)))"
    done = subprocess.run(
        [sys.executable, "-c", jumps],
        env=environment(PYTHONPATH=python_path(folder)),
        capture_output=True,
        text=True,
    )
    assert done.stdout == "True\n"
    run.start()
    run.wait_for(lambda: (run.output / "latest").exists(), "the run")
    run.wait_for_trials(4)
    run.interrupt()
    record = run.record()
    assert {trial.state for trial in record.trials} == {TrialState.COMPLETE}
    assert {recorded.outcome.state for recorded in record.evaluations} == {EvaluationState.COMPLETE}
    assert figures(record.trials) == figures(uninterrupted(trials=4))
