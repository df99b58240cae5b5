"""Metrics of an estimated trajectory, from what was recorded of a run."""

import numpy as np
import pytest

from bo_tuner.codec.reading import read
from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.metrics.trajectory_source import TrajectorySource
from bo_tuner.study.metrics import MetricOfStudy

POSITION = {"truth": ["tx", "ty"], "estimate": ["x", "y"], "measure": "maximum"}


def metric(**changed):
    return read(MetricOfStudy, POSITION | changed, name="error")


def value(signals, **changed):
    recorded = {
        name: RecordedSignal(np.asarray(time, float), np.asarray(values, float))
        for name, (time, values) in signals.items()
    }
    return TrajectorySource(metric(**changed), lambda: Recording(recorded, 10.0)).value({})


def straight(times, estimated_at, *, shift=0.0):
    """A robot at 2 m/s along x, and an estimate that is off by `shift` along y."""
    times, moments = np.asarray(times), np.asarray(estimated_at)
    return {
        "tx": (times, 2.0 * times),
        "ty": (times, 0.0 * times),
        "x": (moments, 2.0 * moments),
        "y": (moments, 0.0 * moments + shift),
    }


def test_the_truth_is_interpolated():
    """At 2 m/s a truth that was held for 0.5 s would be off by up to 1 m."""
    run = straight(np.arange(0.0, 5.0, 0.5), np.arange(0.1, 4.0, 0.2), shift=0.25)
    assert value(run) == pytest.approx(0.25)
    assert value(run, align=True) == pytest.approx(0.0, abs=1e-9)
    assert value(run, measure="rms") == pytest.approx(0.25)


def test_headings_go_on_over_half_a_turn():
    times = np.arange(0.0, 4.0, 0.1)
    yaw = np.mod(2.0 * times + np.pi, 2.0 * np.pi) - np.pi
    run = straight(times, times) | {"tyaw": (times, yaw), "yaw": (times + 0.03, yaw)}
    # The estimate of the heading is 0.03 s late, that is, 0.06 rad off.
    expected = 2.0 * 0.5 * 2.0 * np.sin(0.03)
    drift = value(run, over=0.5, yaw=["tyaw", "yaw"])
    assert drift == pytest.approx(expected, rel=1e-6)


def test_nothing_in_common():
    with pytest.raises(MissingMetricError, match="truth and estimate have no time in common"):
        value(straight([0.0, 1.0], [2.0, 3.0]))
    run = straight([0.0, 1.0], [0.0, 1.0])
    run |= {"tyaw": run["ty"], "yaw": run["y"]}
    with pytest.raises(MissingMetricError, match="the run is not longer than 2 s"):
        value(run, over=2.0, yaw=["tyaw", "yaw"])


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"truth": ["tx"]}, "truth: expected two or three signals"),
        ({"estimate": ["x", "y", "z"]}, "estimate: expected 2 signals, as truth has, found 3"),
        ({"over": 1.0}, "yaw: expected two signals, as [true_yaw, yaw], for over"),
        ({"yaw": ["a", "b"]}, "yaw: needs over"),
        ({"over": 1.0, "yaw": ["a", "b"], "align": True}, "align: a drift is the same"),
        ({"measure": "overshoot"}, "measure: "),
        ({"over": -1.0}, "over: expected a number above 0"),
    ],
)
def test_what_is_refused(changed, expected):
    with pytest.raises(StudyError) as caught:
        metric(**changed)
    assert str(caught.value).startswith(expected)
