"""The deviation of a path from its plan, each at its own stamps."""

import dataclasses

import numpy as np
import pytest
from plans import PATH, plan
from signal_runs import signal_study

from bo_tuner.errors import StudyError
from bo_tuner.metrics.path_source import PathSource
from bo_tuner.metrics.recording import RecordedMessages, RecordedSignal, Recording
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.study.path_metric import PathMetric
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml

SIGNALS = {
    "x": {"frames": ["map", "base_link"], "field": "translation.x"},
    "y": {"frames": ["map", "base_link"], "field": "translation.y"},
    "plan": {"topic": "/plan"},
    "speed": {"topic": "/odom", "field": "twist.twist.linear.x"},
}
DEVIATION = {"path": ["x", "y"], "plan": "plan", "measure": "maximum"}


def mapping(**changes):
    """A study with a deviation, of which some keys are others."""
    return signal_study(
        signals=SIGNALS, metrics={"deviation": DEVIATION | changes}, objective="deviation"
    )


def recording(plans, end=4.0):
    """A run along y = 0 from x = 0 at 1 m/s, and plans by the time that they came."""
    time = np.arange(0.0, end + 0.5)
    zeros = np.zeros_like(time)
    heard = RecordedMessages(np.array([float(t) for t in plans]), PATH, tuple(plans.values()))
    signals = {"x": RecordedSignal(time, time), "y": RecordedSignal(time, zeros)}
    return Recording(signals, end, {"plan": heard})


def value(recorded, **changes):
    study = study_from_mapping(mapping(**changes))
    return PathSource(study.metrics["deviation"], study, lambda: recorded).value({})


def test_the_plan_that_holds_just_then_counts():
    """The first one is 1 m beside the path until 2 s, and the next one 3 m."""
    run = recording({-0.5: plan((0, 1), (9, 1)), 2: plan((0, -3), (9, -3))})
    assert value(run) == pytest.approx(3.0)
    assert value(run, measure="min") == pytest.approx(1.0)
    assert value(run, measure="iae") == pytest.approx(2 * 1.0 + 2 * 3.0)
    assert value(run, measure="percentile", percent=50) == pytest.approx(1.0)


def test_between_the_poses_a_plan_is_straight_and_beyond_its_end_is_its_end():
    assert value(recording({0: plan((0, 0), (4, 0))})) == pytest.approx(0.0, abs=1e-12)
    assert value(recording({0: plan((0, 0), (1, 0))})) == pytest.approx(3.0)
    assert value(recording({0: plan((4, 3))})) == pytest.approx(5.0)


def test_there_is_a_deviation_from_the_first_plan_on():
    late = recording({3: plan((0, 2), (9, 2))})
    assert value(late, measure="iae") == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("plans", "complaint"),
    [
        ({}, "signal plan has no message"),
        ({0: plan()}, "metric deviation: plan has no poses at 0.000 s"),
        ({0: plan((0, 0), frame="odom")}, "plan is in the frame 'odom' and the path in map"),
        ({0: plan((float("nan"), 0), (1, 0))}, "the distance to plan is undefined at 0.000 s"),
    ],
)
def test_plans_without_a_distance(plans, complaint):
    with pytest.raises(MissingMetricError, match=complaint):
        value(recording(plans))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"path": ["x"]}, r"deviation\.path: expected two or three signals, as \[x, y\]"),
        ({"path": "x"}, r"deviation\.path: expected two or three signals"),
        ({"path": ["x", "z"]}, r"path\[1\]: there is no signal 'z'; expected one of x, y, plan"),
        ({"path": ["x", "plan"]}, r"path\[1\]: signal plan has no field; expected a number"),
        ({"plan": "x"}, "plan: expected a signal of whole messages nav_msgs/msg/Path, found x"),
        ({"plan": "paln"}, "plan: there is no signal 'paln'; did you mean 'plan'"),
        ({"measure": "overshoot"}, "measure: unknown 'overshoot'; expected one of iae"),
        ({"measure": "percentile"}, "percent: missing; percentile needs one"),
        ({"percent": 3.0}, "percent: maximum has none"),
        ({"target": 3.0}, "target: unknown key"),
    ],
)
def test_refused_deviations(changes, complaint):
    with pytest.raises(StudyError, match=complaint):
        study_from_mapping(mapping(**changes))


def test_coordinates_of_different_frames_make_no_path():
    mixed = mapping()
    mixed["signals"] = SIGNALS | {"y": {"frames": ["odom", "base_link"], "field": "translation.y"}}
    with pytest.raises(StudyError, match=r"path\[1\]: is in the frame odom, and x is not"):
        study_from_mapping(mixed)


def test_no_run_keeps_a_negative_limit_of_a_distance():
    limited = mapping(measure="mean") | {
        "constraints": {
            "near": {"kind": "chance", "metric": "deviation", "upper": -1.0, "probability": 0.9}
        }
    }
    with pytest.raises(StudyError, match="no run keeps it: mean is at least 0"):
        study_from_mapping(limited)


def test_whole_messages_are_no_numbers():
    astray = mapping()
    astray["metrics"]["last"] = {"of": "plan", "measure": "maximum"}
    with pytest.raises(StudyError, match="of: signal plan has no field: it is whole messages"):
        study_from_mapping(astray)
    stopped = mapping() | {"run": {"end": {"after": 1.0}, "abort_when": "speed > plan"}}
    with pytest.raises(StudyError, match=r"run\.abort_when: signal plan has no field"):
        study_from_mapping(stopped)


def test_it_is_written_and_read_back():
    study = study_from_mapping(mapping())
    assert parse_study(study_to_yaml(study)) == study
    metric = study.metrics["deviation"]
    assert metric == PathMetric(name="deviation", path=("x", "y"), plan="plan", measure="max")
    assert dataclasses.replace(metric, unit="mm").unit == "mm"
