"""Small runs to report on; see tests/browser for how the pages look."""

import sys
from pathlib import Path

import pytest
import yaml

from bo_tuner.report.analysis import Analysis
from bo_tuner.storage.record import read_run

sys.path.append(str(Path(__file__).parents[2] / "browser"))


@pytest.fixture(scope="session")
def axis_run(tmp_path_factory):
    """Function that runs a study of a small object, with changed sections, and reads the run."""
    from report_runs import axis_study, run_study

    def run(**sections):
        text = yaml.safe_dump(axis_study(**sections))
        return read_run(run_study(tmp_path_factory.mktemp("axis"), text))

    return run


@pytest.fixture(scope="session")
def tuned(axis_run):
    """A run of seven trials of which those with a gain above 0.6 failed."""
    from report_runs import with_ends

    return axis_run(**with_ends(0.6))


@pytest.fixture(scope="session")
def analysis(tuned):
    return Analysis(tuned)


@pytest.fixture
def importable(tuned, monkeypatch):
    """Lets the study's objects be imported."""
    monkeypatch.syspath_prepend(str(tuned.path.parents[1]))
