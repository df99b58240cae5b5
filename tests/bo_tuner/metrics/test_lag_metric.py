"""The lag of a signal behind another one, from what was recorded of a run."""

import numpy as np
import pytest

from bo_tuner.codec.reading import read
from bo_tuner.errors import StudyError
from bo_tuner.metrics.lag_source import LagSource
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.study.metrics import LagMetric, MetricOfStudy


def metric(**changed):
    given = {"lag": "rate", "behind": "true_rate"} | changed
    return read(MetricOfStudy, given, name="delay")


def value(late, early, **changed):
    """The lag of signals, each of times and values."""
    recorded = {
        name: RecordedSignal(np.asarray(time, float), np.asarray(values, float))
        for name, (time, values) in {"rate": late, "true_rate": early}.items()
    }
    return LagSource(metric(**changed), lambda: Recording(recorded, 20.0)).value({})


def turning(times):
    return np.sin(1.3 * times) + 0.4 * np.sin(3.1 * times)


def test_messages_at_other_times_and_rates():
    times, moments = np.arange(0.0, 20.0, 0.02), np.arange(0.013, 19.0, 0.05)
    late = (moments, 2.0 * turning(moments - 0.137))
    assert value(late, (times, turning(times))) == pytest.approx(0.137, abs=1e-3)
    assert value((times, turning(times)), late) == pytest.approx(-0.137, abs=1e-3)
    assert value(late, (times, turning(times)), most=0.1) == pytest.approx(0.1)


def test_what_has_no_lag():
    times = np.arange(0.0, 20.0, 0.02)
    signal, short = (times, turning(times)), (times[:100], turning(times[:100]))
    with pytest.raises(MissingMetricError, match="a signal has less than two messages"):
        value(signal, ([0.0], [1.0]))
    with pytest.raises(MissingMetricError, match="for more than 4 s, four times `most`"):
        value(signal, short)
    with pytest.raises(MissingMetricError, match="a signal does not change"):
        value(signal, (times, np.ones_like(times)))


def test_how_it_is_written():
    made = metric(most=0.5)
    assert isinstance(made, LagMetric)
    assert (made.signals, made.unit) == (("rate", "true_rate"), "s")
    with pytest.raises(StudyError, match="lag: there is no signal 'rate'"):
        made.check_signals(["rates", "true_rate"])
    with pytest.raises(StudyError, match="most: expected a number above 0"):
        metric(most=0.0)
    with pytest.raises(StudyError, match="behind: missing"):
        read(MetricOfStudy, {"lag": "rate"}, name="delay")
