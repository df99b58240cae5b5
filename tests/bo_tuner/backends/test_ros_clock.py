"""Clocks of the tuner: a time that no ROS message can tell, and one that it slept through."""

import time
from datetime import UTC, datetime

import pytest

from bo_tuner.backends.ros import suspension
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.suspension import LONGEST, Suspension
from bo_tuner.errors import BackendError
from bo_tuner.trials import EvaluationState, Outcome

COMPLETE = Outcome(EvaluationState.COMPLETE, {"error": 1.0})


@pytest.mark.parametrize("year", [1969, 2038, 2039, 2100])
def test_a_clock_that_ros_cannot_tell(tmp_path, make_study, monkeypatch, year):
    wrong = datetime(year, 6, 1, tzinfo=UTC).timestamp()
    monkeypatch.setattr(time, "time", lambda: wrong)
    with pytest.raises(BackendError, match=rf"shows {year}-06-01; ROS messages hold times"):
        RosBackend(make_study(), tmp_path).open()


class Clock:
    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(suspension, "_now", lambda: self.now)


def test_only_a_gap_between_two_looks_is_a_suspension(monkeypatch):
    clock = Clock(monkeypatch)
    watch = Suspension()
    for _ in range(1000):
        clock.now += LONGEST / 2
        watch.look()
    assert watch.seconds == 0.0
    clock.now += 20.0
    watch.skip()
    watch.look()
    assert watch.seconds == 0.0
    clock.now += 20.0
    watch.look()
    assert watch.seconds == 20.0
    watch.begin()
    assert watch.seconds == 0.0


@pytest.mark.parametrize("suspended", [0, 1, 2, 3])
def test_what_was_slept_through_is_repeated(tmp_path, make_study, monkeypatch, suspended):
    """Whatever came of it, and not for ever."""
    clock = Clock(monkeypatch)
    backend = RosBackend(make_study(), tmp_path)
    attempts = []

    def attempt(planned):
        attempts.append(planned)
        clock.now += 20.0 if len(attempts) <= suspended else 1.0
        lost = Outcome(EvaluationState.LOST, reason="no evaluation result")
        return lost if len(attempts) <= suspended else COMPLETE

    monkeypatch.setattr(backend, "_attempt", attempt)
    outcome = backend.outcome(None)
    if suspended < 3:
        assert outcome == COMPLETE
        assert len(attempts) == suspended + 1
    else:
        assert outcome.state is EvaluationState.LOST
        assert outcome.reason == "the tuner was suspended for 20 s"
