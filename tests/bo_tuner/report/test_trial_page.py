"""The page of a trial: all its evaluations, and the signals of the worst one."""

import dataclasses
import shutil

import numpy as np
import pytest

from bo_tuner.errors import RunRecordError
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.recording.signal_bag import RecordedRun
from bo_tuner.report import recorded_signals
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.failures import failures
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.trials import TUNING, TrialState


@pytest.fixture
def traced(axis_run, monkeypatch):
    """A run on an object that traces its signals, with failures above a gain of 0.6."""
    from report_runs import with_ends

    run = axis_run(**with_ends(0.6))
    monkeypatch.syspath_prepend(str(run.path.parents[1]))
    return Analysis(run)


def page_of(analysis, state):
    # The first one is the default itself.
    trial = next(t for t in analysis.trials if t.state is state and t.number > 0)
    return trial, {section.name: section for section in trial_sections(analysis, trial)}


def test_every_evaluation_is_listed_and_the_worst_one_is_marked(traced):
    trial, parts = page_of(traced, TrialState.COMPLETE)
    (table,) = parts["test-runs"].tables
    column = table.header.index("peak [N]")
    peaks = [float(row[column]) for row in table.rows]
    expected = [evaluation.outcome.metrics["peak"] for evaluation in trial.evaluations]
    np.testing.assert_allclose(peaks, expected, rtol=1e-3)
    assert list(table.marked) == [int(np.argmax(expected))]


def test_the_signals_are_those_of_the_trial_beside_the_default(traced):
    """The object's position is its gain times the number of the step."""
    trial, parts = page_of(traced, TrialState.COMPLETE)
    assert "not recorded" in parts["signals"].lead
    position = parts["signals"].figures[0].panels[0]
    lines = {line.name: line for line in position.elements}
    own = lines[f"trial {trial.number}"]
    np.testing.assert_allclose(own.y, trial.parameters["gain"] * np.arange(5))
    np.testing.assert_allclose(lines["default"].y, 0.5 * np.arange(5))


def test_gaps_in_the_signals_are_told_beside_the_metrics_and_with_the_failures(traced):
    said = "signal x has no message for 0.5 s"
    number = page_of(traced, TrialState.COMPLETE)[0].number

    def marked(evaluation):
        if (evaluation.trial, evaluation.index) != (number, 0) or evaluation.stage not in TUNING:
            return evaluation
        return dataclasses.replace(evaluation, outcome=evaluation.outcome.noted(remark=said))

    record = traced.record
    record = dataclasses.replace(
        record,
        evaluations=tuple(map(marked, record.evaluations)),
        trials=tuple(
            dataclasses.replace(t, evaluations=tuple(map(marked, t.evaluations)))
            for t in record.trials
        ),
    )
    analysis = Analysis(record)
    trial = next(t for t in analysis.trials if t.number == number)
    (table,) = next(s for s in trial_sections(analysis, trial) if s.name == "test-runs").tables
    states = [row[table.header.index("state")] for row in table.rows]
    assert states == [f"complete: {said}", *["complete"] * (len(states) - 1)]
    expected = f"Gaps in signals, trial {number}, test run 0: {said}."
    assert failures(analysis).notes == [expected]


def test_a_bag_without_signals_is_named(traced, monkeypatch):
    trial, parts = page_of(traced, TrialState.COMPLETE)
    name = f"bags/trial_{trial.number:04d}"
    assert name not in parts["signals"].lead
    monkeypatch.setattr(recorded_signals, "recorded_runs", lambda _: iter(()))
    bag = traced.record.path / name
    bag.mkdir(parents=True)
    try:
        _, parts = page_of(traced, TrialState.COMPLETE)
        assert parts["signals"].lead.endswith(f" The messages of the trial are in {name}.")
        assert parts["signals"].figures
    finally:
        bag.rmdir()
        bag.parent.rmdir()


def test_recorded_signals_come_first(traced, monkeypatch):
    trial, _ = page_of(traced, TrialState.COMPLETE)
    worst = max(trial.evaluations, key=lambda e: e.outcome.metrics["peak"])
    time = np.linspace(0.0, 1.0, 7)
    recording = Recording({"speed": RecordedSignal(time, time**2)}, end=1.0)
    other = RecordedRun("trial_0", trial.number, {"index": worst.index + 1}, recording)
    own = dataclasses.replace(other, evaluation={"index": worst.index})
    bag = traced.record.path / "bags" / f"trial_{trial.number:04d}"
    bag.mkdir(parents=True)
    (bag / "metadata.yaml").touch()
    monkeypatch.setattr(recorded_signals, "recorded_runs", lambda _: iter([other, own]))
    try:
        _, parts = page_of(traced, TrialState.COMPLETE)
        assert parts["signals"].lead.startswith("Recorded in bags/")
        (panel,) = parts["signals"].figures[0].panels
        np.testing.assert_array_equal(panel.elements[0].y, time**2)

        def damaged(_):
            raise RunRecordError("bags/x: cannot be read")

        monkeypatch.setattr(recorded_signals, "recorded_runs", damaged)
        _, parts = page_of(traced, TrialState.COMPLETE)
        assert parts["signals"].lead == "No signals: bags/x: cannot be read."
    finally:
        shutil.rmtree(bag.parent)


def test_a_failed_trial_tells_its_reason(traced):
    trial, parts = page_of(traced, TrialState.FAILED)
    assert parts["trial"].title == f"Trial {trial.number}: failed"
    assert trial.reason in parts["trial"].lead
    assert parts["signals"].lead.startswith("No signals: the test run failed: ")
    (table,) = parts["test-runs"].tables
    assert "window.harmed" in table.rows[0][-1]
