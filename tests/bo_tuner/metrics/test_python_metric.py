"""Metrics by a function of the user."""

import numpy as np
import pytest
from signal_runs import outcome_of, signal_study

from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml
from bo_tuner.trials import EvaluationState

FUNCTIONS = """
import numpy as np

def energy(signals):
    time, value = signals["x"]
    return np.sum(value[:-1] ** 2 * np.diff(time))

def seen(signals):
    seen.signals = signals
    return 1

def absent(signals):
    return signals["z"][1].max()

def nothing(signals): pass
def text(signals): return "3.0"
def array(signals): return np.ones(1)
def truth(signals): return True
def nan(signals): return float("nan")
def huge(signals): return 10**400
def late(signals):
    time, value = signals["x"]
    time += 5.0
    value *= 0.0
    return 0.0

number = 3.0
"""
# x is 0 before the start, 2 from 1 s and 4 from 3 s on.
X = RecordedSignal(np.array([-0.7, 1.0, 3.0]), np.array([0.0, 2.0, 4.0]))
EMPTY = RecordedSignal(np.array([]), np.array([]))
RECORDING = Recording({"x": X, "y": EMPTY}, end=5.0)


@pytest.fixture(autouse=True)
def functions(tmp_path, monkeypatch):
    (tmp_path / "users_metrics.py").write_text(FUNCTIONS)
    (tmp_path / "users_broken.py").write_text("import no_such_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("users_metrics", "users_broken"):
        monkeypatch.delitem(__import__("sys").modules, name, raising=False)


def study(path):
    signals = {name: {"topic": name, "field": "data", "minimum_messages": 0} for name in "xy"}
    metrics, objective = {"own": {"python": path, "unit": "J"}}, {"metric": "own"}
    return study_from_mapping(signal_study(signals=signals, metrics=metrics, objective=objective))


def outcome(function):
    return outcome_of(study(f"users_metrics:{function}"), RECORDING)


def test_a_function_of_the_signals():
    found = outcome("energy")
    # 2² for 2 s and 4² for 2 s.
    assert (found.state, found.metrics) == (EvaluationState.COMPLETE, {"own": 40.0})


def test_what_the_function_is_given():
    """The value that holds at the start stands at 0, and the last one at the end."""
    outcome("seen")
    ((name, (time, value)),) = __import__("users_metrics").seen.signals.items()
    assert name == "x"
    np.testing.assert_array_equal([time, value], [[0, 1, 3, 5], [0, 2, 4, 4]])


def test_a_function_cannot_change_the_recording():
    assert outcome("late").metrics == {"own": 0.0}
    np.testing.assert_array_equal([X.time, X.value], [[-0.7, 1, 3], [0, 2, 4]])


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("absent", "metric own: users_metrics:absent raised KeyError: 'z'"),
        ("nothing", "metric own: users_metrics:nothing returned nothing, expected a number"),
        ("text", "metric own: users_metrics:text returned text '3.0', expected a number"),
        ("array", "metric own: users_metrics:array returned a ndarray, expected a number"),
        ("truth", "metric own: users_metrics:truth returned true, expected a number"),
        ("nan", "metric own is nan"),
        ("huge", "metric own is 1"),
    ],
)
def test_no_number(function, reason):
    found = outcome(function)
    assert found.state is EvaluationState.FAILED
    assert found.reason.startswith(reason)


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        ("users_metrics:energie", "cannot import users_metrics:energie: AttributeError: module"),
        ("users_broken:f", "cannot import users_broken:f: ModuleNotFoundError: No module named"),
        ("users_metrics:number", "expected a function, found 3.0"),
    ],
)
def test_no_function(path, problem):
    with pytest.raises(StudyError) as caught:
        signal_sources(study(path), lambda: RECORDING)
    assert str(caught.value).startswith(f"metrics.own.python: {problem}")


def test_what_is_written_reads_back_equal():
    made = study("users_metrics:energy")
    assert parse_study(study_to_yaml(made)) == made
