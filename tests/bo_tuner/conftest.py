"""Fixtures of the tuner's tests: studies of plain functions, a backend for them, and a run."""

import shutil
import signal

import pytest
from functions import (  # noqa: F401  (fixtures)
    _failed,
    _function_backend,
    _make_study,
    _make_trial,
)


@pytest.fixture(scope="session")
def axis_run(tmp_path_factory):
    """Function that runs a study of a small object, with changed sections, and reads the run."""
    from report_runs import run_axis

    from bo_tuner.storage.record import read_run

    def run(**sections):
        return read_run(run_axis(tmp_path_factory.mktemp("axis"), **sections))

    return run


@pytest.fixture(scope="session")
def tuned(axis_run):
    """A run of seven trials of which those with a gain above 0.6 failed."""
    from report_runs import with_ends

    return axis_run(**with_ends(0.6))


@pytest.fixture
def run(tuned, tmp_path):
    """A copy of the run, whose folder may be changed."""
    from bo_tuner.storage.record import read_run

    shutil.copytree(tuned.path, tmp_path / "run")
    return read_run(tmp_path / "run")


@pytest.fixture
def handlers():
    """Signals as in the foreground: a shell lets what runs in the background ignore some."""
    from bo_tuner.interruption import SIGNALS

    before = {signum: signal.getsignal(signum) for signum in (*SIGNALS, signal.SIGTSTP)}
    for signum in before:
        signal.signal(signum, signal.SIG_DFL)
    yield
    for signum, handler in before.items():
        signal.signal(signum, handler)
