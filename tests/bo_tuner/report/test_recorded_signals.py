"""Trajectories of a study with signals: from the bags, the worst run of default and tuned."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from signal_runs import ANGLE, record_run, signal_study

from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.trajectories import response, trajectories
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import EvaluationState, Outcome

STUDY = study_from_mapping(
    signal_study(signals={"angle": ANGLE}, metrics={"error": {"of": "1 - angle", "measure": "iae"}})
)
GAINS = (0.5, 1.5)


def recording(gain, index):
    """A step that is slower by `index`, which makes the last run the worst."""
    time = np.linspace(0.0, 2.0, 101)
    angle = 1.0 - np.exp(-2.0 * gain * time / (1.0 + index))
    return Recording({"angle": RecordedSignal(time, angle)}, 2.0)


@pytest.fixture
def folder(tmp_path):
    """A run of the default and one better trial, three evaluations each, all recorded."""
    heard = {gain: [recording(gain, index) for index in range(3)] for gain in GAINS}
    return record_run(tmp_path / "run", STUDY, heard)


def test_the_worst_run_of_each_is_drawn_as_it_was_heard(folder):
    analysis = Analysis(read_run(folder))
    section = trajectories(analysis)
    (panel,) = response(analysis).panels
    default, best = panel.elements
    # The run has no result yet.
    assert (default.name, best.name) == ("default", "best so far")
    for line, gain in zip((default, best), GAINS, strict=True):
        heard = recording(gain, 2).signals["angle"]
        np.testing.assert_array_equal(line.x, heard.time)
        np.testing.assert_array_equal(line.y, heard.value)
    assert "default: test run 2 in bags/trial_0000" in section.lead
    assert "best so far: test run 2 in bags/trial_0001" in section.lead


def test_what_was_heard_of_a_run_that_somebody_disturbed_is_not_that_of_its_repetition(folder):
    """It was made again, and has the place of the first attempt."""
    bags = folder / "bags"
    run = read_run(folder)
    worst = run.trials[0].evaluations[2]
    disturbed = Outcome(EvaluationState.FAILED, reason="the clock was set")
    recorder = Recorder(bags, STUDY, RecordOptions(Policy.ALL))
    recorder.evaluation(replace(worst, outcome=disturbed), recording(0.1, 9))
    recorder.trial(run.trials[0], best=False)
    recorder.close()
    (bags / "trial_0000").rename(bags / "trial_0000_part3")
    (bags / "trial_0000_part2").rename(bags / "trial_0000")
    default, _ = response(Analysis(read_run(folder))).panels[0].elements
    np.testing.assert_array_equal(default.y, recording(0.5, 2).signals["angle"].value)


def test_a_side_without_a_bag_is_told(folder):
    shutil.rmtree(folder / "bags" / "trial_0000")
    analysis = Analysis(read_run(folder))
    section = trajectories(analysis)
    assert [line.name for line in response(analysis).panels[0].elements] == ["best so far"]
    assert "default: no bag has a run" in section.lead


def test_a_bag_that_is_being_written_is_no_damage(folder):
    """That of a trial which goes on in a second bag."""
    writing = folder / "bags" / "trial_0001_part2.partial"
    (writing / "trial_0001_part2").mkdir(parents=True)
    (folder / "bags" / "trial_0000").rename(folder / "bags" / "trial_0000_part2")
    # Without a bag of the default, each of its evaluations is looked for in all that there are.
    (folder / "bags" / "trial_0000_part3.partial").mkdir()
    shutil.move(folder / "bags" / "trial_0001", writing / "trial_0001_part2")
    analysis = Analysis(read_run(folder))
    section = trajectories(analysis)
    assert [line.name for line in response(analysis).panels[0].elements] == ["default"]
    assert "best so far: no bag has a run" in section.lead


def test_without_bags_there_is_advice(folder):
    shutil.rmtree(folder / "bags")
    section = trajectories(Analysis(read_run(folder)))
    assert section.figures == ()
    assert section.lead.endswith("tune with --record notable or all.")


def test_a_damaged_bag_is_no_failure_of_the_report(folder):
    (folder / "bags" / "trial_0001" / "metadata.yaml").write_text("nothing")
    section = trajectories(Analysis(read_run(folder)))
    assert section.figures == ()
    assert section.lead.startswith("No signals: ")
    assert "cannot be read" in section.lead
