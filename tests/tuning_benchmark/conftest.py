"""Campaigns on a study in closed form, whose evaluations cost nothing."""

import pytest
from functions import (  # noqa: F401  (fixtures)
    _failed,
    _function_backend,
    _make_study,
    _make_trial,
)

from bo_tuner.study.study_file import study_to_yaml
from tuning_benchmark.campaign.cost import valley
from tuning_benchmark.campaign.runs import RunSize
from tuning_benchmark.experiments.experiment import Case, Row

JUDGE = "valley:Judge"

EXPERIMENT = """\
name: closed
judge: valley:Judge
cases:
  valley:
    title: A valley
    study: valley.yaml
    runs: 2
    evaluations: 60
    reserved_evaluations: 20
    initial_trials: 3
    rows:
      I: {algorithm: I, evaluations: 10}
      IV: {algorithm: IV}
      draws: {optimizer: "valley:Draws", protocol: random, contexts: 6}
      lent: {optimizer: "valley:Draws"}
"""


@pytest.fixture(scope="session")
def study():
    return valley(2, seed=1, trials=20)


@pytest.fixture(scope="session")
def small():
    """Size of a small run."""
    return RunSize(evaluations=60, reserved=20, initial_trials=3)


def write_experiment(folder, study):
    """Write an experiment file with its study beside it."""
    (folder / "valley.yaml").write_text(study_to_yaml(study))
    file = folder / "closed.yaml"
    file.write_text(EXPERIMENT)
    return file


@pytest.fixture
def experiment_file(tmp_path, study):
    return write_experiment(tmp_path, study)


@pytest.fixture(scope="module")
def campaign_folder(tmp_path_factory, study):
    """Folder with the experiment file, for a campaign that the tests of a module share."""
    folder = tmp_path_factory.mktemp("campaign")
    write_experiment(folder, study)
    return folder


@pytest.fixture
def make_case(study):
    """Function that makes a case of two rows, with fields changed."""

    def make(**fields):
        rows = {"A": Row(name="A", algorithm="IV"), "B": Row(name="B", algorithm="II")}
        given = {"name": "c", "title": "C", "study": study, "runs": 2, "rows": rows}
        given["evaluations"] = 100
        return Case(**(given | fields))

    return make


def answer(objective=1.0, worst=0.5, feasible=True, held=True, training=0.9, narrow=False):
    """An answer's record with its verdict."""
    truth = {"objective": objective, "standard_error": 0.01, "worst": worst, "feasible": feasible}
    neighbour = {"parameters": {"g0": 0.5, "g1": 0.5}, "changed": ["g0"]}
    return {
        "trial": 0,
        "believed": True,
        "training": training,
        "parameters": {"g0": 0.5, "g1": 0.25},
        "validation": {"objective": objective, "feasible": held},
        "truth": truth,
        "neighbours": [neighbour | {"truth": truth, "tolerable": not narrow}],
    }


def record(found, trajectory=(), incumbents=None):
    """A run's record around an answer, or around none."""
    result = {
        "cuts": 100,
        "check_cuts": 20,
        "trajectory": list(trajectory),
        "incumbents": incumbents or {},
        "answer": found,
        "ranked": None,
        "seconds": {"optimizer": 1.0, "cuts": 3.0},
    }
    about = {"commit": "c0ffee", "machine": "m", "versions": "v", "date": "2026-01-01"}
    return {"failed": "", "result": result, "wall_seconds": 4.0, "about": about}


@pytest.fixture(scope="session", name="answer")
def _answer():
    return answer


@pytest.fixture(scope="session", name="record")
def _record():
    return record


@pytest.fixture(scope="session")
def without_times():
    """Function that takes the times out of a run's result."""

    def strip(result):
        return {key: value for key, value in result.items() if key != "seconds"}

    return strip
