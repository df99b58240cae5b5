"""Clocks of the tuner: a time that no ROS message can tell."""

import time
from datetime import UTC, datetime

import pytest

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.errors import BackendError


@pytest.mark.parametrize("year", [1969, 2038, 2039, 2100])
def test_a_clock_that_ros_cannot_tell(tmp_path, make_study, monkeypatch, year):
    wrong = datetime(year, 6, 1, tzinfo=UTC).timestamp()
    monkeypatch.setattr(time, "time", lambda: wrong)
    with pytest.raises(BackendError, match=rf"shows {year}-06-01; ROS messages hold times"):
        RosBackend(make_study(), tmp_path).open()
