"""The option for the longest time of a command."""

import argparse

import pytest

from bo_tuner.cli.time_limit import TimeLimit, time_limit


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90.0), ("10min", 600.0), ("2h", 7200.0), ("1.5 h", 5400.0)]
)
def test_a_time_with_its_unit(text, seconds):
    found = time_limit(text)
    assert found.seconds == seconds
    assert not found.over


@pytest.mark.parametrize("text", ["10", "min", "-5min", "0s", "10m", "1e3s", "nan s", "", "5 days"])
def test_anything_else_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="expected a time such as 90s, 10min"):
        time_limit(text)


def test_without_a_limit_it_is_never_over():
    assert not TimeLimit().over
    assert TimeLimit(0.0).over
