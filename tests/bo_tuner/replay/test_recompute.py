"""Metrics from the bags of a run are those of the run, and others can be had of its signals."""

import csv
import dataclasses
import json

import numpy as np
import pytest
from commands import run
from plans import PATH, plan
from signal_runs import SETPOINT, record_run, recording, signal_study

from bo_tuner.errors import RunRecordError
from bo_tuner.metrics.recording import RecordedMessages
from bo_tuner.recording.signal_bag import recorded_runs
from bo_tuner.replay.recompute import differing, recompute
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping, study_to_yaml
from bo_tuner.trials import EvaluationState, Outcome

RUNS = 3
STUDY = signal_study()
ODOMETRY = {"angle": {"topic": "/odom", "field": "x"}, "setpoint": SETPOINT}


def make_study(**sections):
    metrics = STUDY["metrics"] | {"peak": {"of": "angle", "measure": "maximum"}}
    return study_from_mapping(STUDY | {"metrics": metrics} | sections)


@pytest.fixture
def folder(tmp_path):
    """A run folder with one trial and its bag."""
    return record_run(tmp_path / "run", make_study(), {0.5: [recording(k) for k in range(RUNS)]})


def test_a_bag_has_the_signals_as_they_were_heard(folder):
    runs = list(recorded_runs(folder / "bags" / "trial_0000"))
    assert [(item.trial, item.evaluation["index"]) for item in runs] == [
        (0, k) for k in range(RUNS)
    ]
    for k, item in enumerate(runs):
        heard = recording(k)
        assert item.recording.end == heard.end
        for name, signal in heard.signals.items():
            found = item.recording.signals[name]
            assert np.array_equal(found.time, signal.time)
            assert np.array_equal(found.value, signal.value)
            assert (found.lost, found.late) == (signal.lost, signal.late)


def test_the_same_definition_gives_the_same_number(folder):
    record = read_run(folder)
    found = list(recompute(record, record.study))
    for item, evaluation in zip(found, record.trials[0].evaluations, strict=True):
        assert item.outcome.metrics == evaluation.outcome.metrics
        assert differing(record, record.study, item) == []


def test_whole_messages_are_in_the_bag_in_their_order_whatever_their_stamps(tmp_path):
    """A metric of a plan is recomputed as it was; so is that of runs without any plan."""
    study = make_study(
        signals=STUDY["signals"] | {"plan": {"topic": "/plan", "minimum_messages": 0}},
        metrics=STUDY["metrics"]
        | {"deviation": {"path": ["angle", "setpoint"], "plan": "plan", "measure": "rms"}},
    )
    data = (plan((0, 0), (1, 3)), plan((2, 2)), plan((0, 1), (0, 5), frame="a longer name"))
    heard = [
        RecordedMessages(np.array([-0.2, 0.4, 1.1]), PATH, data, lost=1, late=3),
        RecordedMessages(np.array([]), PATH, ()),
        RecordedMessages(np.array([0.1]), PATH, data[:1]),
    ]
    runs = [dataclasses.replace(recording(k), messages={"plan": h}) for k, h in enumerate(heard)]
    record = read_run(record_run(tmp_path / "run", study, {0.5: runs}))
    found = [item.recording for item in recorded_runs(record.path / "bags" / "trial_0000")]
    for item, expected in zip(found, runs, strict=True):
        seen, was = item.messages["plan"], expected.messages["plan"]
        assert np.array_equal(seen.time, was.time)
        assert (seen.type, seen.data, seen.lost, seen.late) == (PATH, was.data, was.lost, was.late)
        assert item.signals.keys() == expected.signals.keys()
    outcomes = [item.outcome for item in recompute(record, study)]
    recorded = [evaluation.outcome for evaluation in record.trials[0].evaluations]
    assert [o.state for o in outcomes] == [o.state for o in recorded]
    assert [o.complete for o in outcomes] == [True, False, True]
    assert [o.metrics for o in outcomes] == [o.metrics for o in recorded]


@pytest.mark.parametrize(
    "change",
    [{"publisher": "/arm"}, {"merge": True}, {"frames": ["map", "base"]}, {"time": "reception"}],
    ids=str,
)
def test_another_source_of_a_signal_was_not_recorded(folder, change):
    signals = STUDY["signals"] | {"angle": STUDY["signals"]["angle"] | change}
    with pytest.raises(RunRecordError, match="has no recording of signal angle"):
        list(recompute(read_run(folder), make_study(signals=signals)))


def test_what_a_signal_must_keep_is_no_other_signal(folder):
    signals = STUDY["signals"] | {"angle": STUDY["signals"]["angle"] | {"largest_gap": 9.0}}
    assert list(recompute(read_run(folder), make_study(signals=signals)))


def test_another_study_measures_the_same_signals(folder):
    other = make_study(
        metrics={
            "error": {"of": "setpoint - angle", "measure": "ise"},
            "least": {"of": "angle", "measure": "minimum"},
        }
    )
    (first, *_) = recompute(read_run(folder), other)
    heard = recording(0)
    assert first.outcome.metrics["least"] == heard.signals["angle"].value.min()
    time = np.concatenate([heard.signals["angle"].time, [2.0]])
    squared = (1.0 - heard.signals["angle"].value) ** 2
    # Zero-order hold from the first message on.
    expected = float(np.sum(np.diff(time) * squared))
    assert first.outcome.metrics["error"] == pytest.approx(expected)
    # Another definition under the same name is not held against the record.
    assert differing(read_run(folder), other, first) == []


def test_the_command(folder, tmp_path):
    code, out, err = run("recompute", folder, "--csv", "out.csv", folder=tmp_path)
    assert (code, err) == (0, "")
    assert f"{RUNS} test runs; 0 differ from the record" in out
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    metrics = [e.outcome.metrics for e in read_run(folder).trials[0].evaluations]
    assert [float(row["error"]) for row in rows] == [item["error"] for item in metrics]


def test_what_is_relative_to_the_default_is_left_out_by_name(folder, tmp_path):
    """The runs of the default beside those of the bags were not recorded."""
    limit = {"kind": "chance", "metric": "peak", "upper": "1.1 * default", "probability": 0.9}
    (tmp_path / "other.yaml").write_text(study_to_yaml(make_study(constraints={"peak": limit})))
    code, out, err = run("recompute", folder, "--study", "other.yaml", folder=tmp_path)
    assert (code, err) == (0, "")
    table, _, rest = out.partition("left out: peak_minus_1.1_default, relative to the default")
    assert "peak" in table
    assert "default" not in table
    assert f"{RUNS} test runs; 0 differ from the record" in rest


def test_a_number_that_is_not_the_recorded_one(folder, tmp_path):
    metadata = folder / "bags" / "trial_0000" / "metadata.yaml"
    peak = read_run(folder).trials[0].evaluations[1].outcome.metrics["peak"]
    metadata.write_text(metadata.read_text().replace(json.dumps(peak), json.dumps(peak + 1.0)))
    code, out, err = run("recompute", folder, folder=tmp_path)
    assert (code, err) == (3, "")
    assert "1 differ from the record" in out


def test_metrics_that_cannot_be_computed_any_more_are_not_as_recorded(folder):
    """Those of another study that cannot be computed tell nothing of the record."""
    record = read_run(folder)
    failed = Outcome(EvaluationState.FAILED, reason="metric error: division by zero")
    for item in recompute(record, record.study):
        lost = dataclasses.replace(item, outcome=failed)
        assert set(differing(record, record.study, lost)) == set(record.study.metrics)
        assert differing(record, make_study(objective={"metric": "peak"}), lost) == []


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"signals": ODOMETRY},
            "has no recording of signal angle (/odom x); it has setpoint, angle",
        ),
        (None, "has no bag with signals"),
    ],
)  # fmt: skip
def test_what_cannot_be_recomputed(folder, tmp_path, changes, problem):
    arguments = []
    if changes is None:
        (folder / "bags").rename(tmp_path / "elsewhere")
    else:
        (tmp_path / "other.yaml").write_text(study_to_yaml(make_study(**changes)))
        arguments = ["--study", "other.yaml"]
    code, out, err = run("recompute", folder, *arguments, folder=tmp_path)
    assert (code, out) == (2, "")
    assert problem in err
    assert err.count("\n") == 1


def test_metrics_that_nodes_report(folder, tmp_path):
    code, _, err = run("recompute", folder, "--study", "benchmark", folder=tmp_path)
    assert code == 2
    assert "metric tracking_error is reported by a node" in err


def test_a_damaged_bag(folder, tmp_path):
    (bag,) = (folder / "bags" / "trial_0000").glob("*.mcap")
    bag.write_bytes(bag.read_bytes()[:100])
    code, _, err = run("recompute", folder, folder=tmp_path)
    assert code == 2
    assert "trial_0000: cannot be read" in err
