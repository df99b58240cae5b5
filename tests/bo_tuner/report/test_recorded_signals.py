"""Trajectories of a study with signals: from the bags, the worst run of default and tuned."""

import shutil

import numpy as np
import pytest

from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import RecordedSignal, Recording, signal_sources
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.trajectories import trajectories
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import STUDY_YAML
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping, study_to_yaml
from bo_tuner.trials import Evaluation, Stage, Trial, TrialState

NODE = {"node": "pid"}
STUDY = study_from_mapping(
    {
        "name": "servo",
        "nodes": {"pid": NODE},
        "parameters": {"kp": NODE | {"type": "double", "bounds": [0, 1], "default": 0.25}},
        "signals": {"angle": {"topic": "/angle", "field": "data"}},
        "run": {"end": {"after": 2.0}},
        "metrics": {"error": {"of": "1 - angle", "measure": "iae"}},
        "objective": {"metric": "error"},
        "budget": {"trials": 2, "initial_trials": 1},
    }
)
GAINS = (0.25, 0.75)


def recording(gain, index):
    """A step that is slower by `index`, which makes the last run the worst."""
    time = np.linspace(0.0, 2.0, 101)
    angle = 1.0 - np.exp(-4.0 * gain * time / (1.0 + index))
    return Recording({"angle": RecordedSignal(time, angle)}, 2.0)


@pytest.fixture
def folder(tmp_path):
    """A run of the default and one better trial, three evaluations each, all recorded."""
    path = tmp_path / "run"
    path.mkdir()
    (path / "study.yaml").write_text(study_to_yaml(STUDY))
    recorder = Recorder(path / "bags", STUDY, RecordOptions(Policy.ALL))
    trials = []
    for number, gain in enumerate(GAINS):
        evaluations = []
        for index in range(3):
            heard = recording(gain, index)
            outcome = Collector(STUDY, signal_sources(STUDY, lambda heard=heard: heard)).outcome({})
            evaluations.append(
                Evaluation(number, index, Stage.DRAWN, {"kp": gain}, {}, index, outcome)
            )
            recorder.evaluation(evaluations[-1], heard)
        trial = Trial(number, {"kp": gain}, "", TrialState.COMPLETE, "", tuple(evaluations))
        recorder.trial(trial, best=True)
        trials.append(trial)
    recorder.close()
    provenance = {"algorithm": "IV", "backend": "ros", STUDY_YAML: study_to_yaml(STUDY)}
    Journal(path / "journal.sqlite", provenance, trials).close()
    return path


def test_the_worst_run_of_each_is_drawn_as_it_was_heard(folder):
    section = trajectories(Analysis(read_run(folder)))
    (figure,) = section.figures
    (panel,) = figure.panels
    default, best = panel.elements
    # The run has no result yet.
    assert (default.name, best.name) == ("default", "best so far")
    for line, gain in zip((default, best), GAINS, strict=True):
        heard = recording(gain, 2).signals["angle"]
        np.testing.assert_array_equal(line.x, heard.time)
        np.testing.assert_array_equal(line.y, heard.value)
    assert "default: evaluation 2 in bags/trial_0000" in section.lead
    assert "best so far: evaluation 2 in bags/trial_0001" in section.lead


def test_a_side_without_a_bag_is_told(folder):
    shutil.rmtree(folder / "bags" / "trial_0000")
    section = trajectories(Analysis(read_run(folder)))
    assert [line.name for line in section.figures[0].panels[0].elements] == ["best so far"]
    assert "default: no bag has a run" in section.lead


def test_without_bags_there_is_advice(folder):
    shutil.rmtree(folder / "bags")
    section = trajectories(Analysis(read_run(folder)))
    assert section.figures == ()
    assert section.lead.endswith("tune with --record notable or all.")


def test_a_damaged_bag_is_no_failure_of_the_report(folder):
    (folder / "bags" / "trial_0001" / "metadata.yaml").write_text("nothing")
    section = trajectories(Analysis(read_run(folder)))
    assert section.figures == ()
    assert section.lead.startswith("No trajectories: ")
    assert "cannot be read" in section.lead
