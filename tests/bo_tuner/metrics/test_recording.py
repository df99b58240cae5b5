"""Signals of a run: held between their messages, whole or failed, and measured."""

import re
from dataclasses import replace

import numpy as np
import pytest
from signal_runs import outcome_of, signal_study

from bo_tuner.metrics.recording import (
    FailedRunError,
    RecordedMessages,
    RecordedSignal,
    Recording,
)
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.numerics.expressions import Expression
from bo_tuner.run_notes import Messages
from bo_tuner.study.signals import Signal, expression
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import EvaluationState

NAMES = ("x", "y")


def recorded(time, value):
    return RecordedSignal(np.array(time, dtype=float), np.array(value, dtype=float))


# x is 0 before the start, 2 from 1 s and 4 from 3 s on; y begins at 0.5 s and is -1 from 2 s on.
RECORDING = Recording(
    {"x": recorded([-0.7, 1, 3], [0, 2, 4]), "y": recorded([0.5, 2], [1, -1])}, end=5.0
)


@pytest.mark.parametrize(
    ("text", "time", "value"),
    [
        ("x", [0, 1, 3, 5], [0, 2, 4, 4]),
        ("y", [0.5, 2, 5], [1, -1, -1]),
        ("x - y", [0.5, 1, 2, 3, 5], [-1, 1, 3, 5, 5]),
        ("x * t", [0, 1, 3, 5], [0, 2, 12, 20]),
        ("0 * x + 3", [0, 1, 3, 5], [3, 3, 3, 3]),
    ],
)
def test_signals_hold_between_their_messages(text, time, value):
    found = RECORDING.sample(expression(text, NAMES))
    np.testing.assert_array_equal(found, [time, value])


def test_without_what_holds_at_start_and_end():
    found = RECORDING.sample(Expression("x", NAMES), held=False)
    np.testing.assert_array_equal(found, [[1, 3], [2, 4]])


def study(**metrics):
    """A study with metrics of x and y."""
    signals = {name: {"topic": name, "field": "data"} for name in NAMES}
    objective = {"metric": next(iter(metrics))}
    return study_from_mapping(signal_study(signals=signals, metrics=metrics, objective=objective))


def outcome(recording, **metrics):
    return outcome_of(study(**metrics), recording)


def test_metrics_of_a_run():
    found = outcome(
        RECORDING,
        # From 0.5 s on: 1 for 0.5 s, 1 for 1 s, 3 for 1 s and 5 for 2 s.
        error={"of": "x - y", "measure": "iae"},
        # 2 after 1 s at 3 s; what held before the start has no slope.
        rate={"of": "x", "measure": "largest_rate"},
        gap={"of": "x", "measure": "largest_gap"},
        # A step from 0 to 4 - 1 goes beyond it by a third.
        overshoot={"of": "x", "measure": "overshoot", "target": "x + y"},
        half={"of": "x", "measure": "percentile", "percent": 50},
    )
    assert found.state is EvaluationState.COMPLETE
    assert found.metrics == pytest.approx(
        {"error": 0.5 + 1 + 3 + 10, "rate": 1.0, "gap": 2.0, "overshoot": 100 / 3, "half": 2.0}
    )


def test_a_run_begins_before_the_first_message_of_a_signal():
    late = Recording({"y": recorded([4, 4.5], [2, 1])}, end=5.0)
    found = outcome(
        late,
        gap={"of": "y", "measure": "largest_gap"},
        duration={"of": "y", "measure": "duration"},
        # 2 t from 4 to 4.5 s and t from 4.5 to 5 s.
        itae={"of": "y", "measure": "itae"},
        iae={"of": "y", "measure": "iae"},
    )
    itae = 2 * (4.5**2 - 4**2) / 2 + (5**2 - 4.5**2) / 2
    assert found.metrics == pytest.approx({"gap": 4.0, "duration": 5.0, "itae": itae, "iae": 1.5})


@pytest.mark.parametrize(
    ("metric", "reason"),
    [
        ({"of": "1 / x", "measure": "mean"}, "metric error: 1 / x is undefined at 0.000 s"),
        (
            {"of": "x", "measure": "settling_time", "target": 9},
            "metric error: x does not settle within 0.02 of the step to 9",
        ),
        (
            # x is 0 at the start.
            {"of": "x", "measure": "overshoot", "target": 0.001},
            "metric error: x begins at 0 with the target 0.001, beside a range of ",
        ),
        ({"of": "exp(900 * x)", "measure": "mean"}, "metric error: exp(900 * x) is undefined at 1"),
        ({"of": "x * 1e200", "measure": "ise"}, "metric error is inf"),
        *(
            (
                {"of": "x", "measure": measure, "target": "4 / (x - 4)"},
                "metric error: its target, 4 / (x - 4), is undefined at the end",
            )
            for measure in ("overshoot", "settling_time", "rise_time")
        ),
    ],
)
def test_a_metric_that_is_not_defined_fails_the_run_and_says_why(metric, reason):
    with np.errstate(over="ignore"):
        found = outcome(RECORDING, error=metric)
    assert found.state is EvaluationState.FAILED
    assert found.reason.startswith(reason)


def test_a_signal_without_a_message():
    silent = Recording({"x": recorded([], [])}, 5.0)
    with pytest.raises(MissingMetricError, match="signal x has no message"):
        silent.sample(Expression("x", NAMES))


@pytest.mark.parametrize(
    ("time", "largest_gap", "silence"),
    [([-3, 1], 3, 4), ([-3, 1], 4, 0), ([-3], 7, 8), ([1], None, 0), ([], 1, 0)],
)
def test_the_silence_of_a_signal(time, largest_gap, silence):
    spec = Signal(name="x", topic="/a", field="data", largest_gap=largest_gap)
    recording = Recording({"x": recorded(time, time)}, 5.0)
    assert recording.silence("x", spec) == silence


@pytest.mark.parametrize(
    ("time", "value", "limits", "reason"),
    [
        ([1, 2], [0, np.nan], {}, "signal x (/a) is nan at 2.000 s"),
        ([1, 2], [-np.inf, 0], {}, "signal x (/a) is -inf at 1.000 s"),
        ([], [], {}, "signal x (/a) has 0 messages in a run of 5 s, expected at least 1"),
        ([-1], [3], {}, "expected at least 1; the latest has a stamp before the start"),
        ([1, 2], [0, 0], {"minimum_messages": 3}, "has 2 messages in a run of 5 s, expected at le"),
        ([1, 4], [0, 0], {"largest_gap": 2}, "has no message for 3 s from 1.000 s on, expected on"),
        ([3, 4], [0, 0], {"largest_gap": 2}, "has no message for 3 s from 0.000 s on"),
        ([1, 2], [0, 0], {"largest_gap": 2}, "has no message for 3 s from 2.000 s on"),
    ],
)
def test_a_signal_that_is_not_whole_fails_the_run(time, value, limits, reason):
    spec = Signal(name="x", topic="/a", field="data", **limits)
    with pytest.raises(FailedRunError) as caught:
        Recording({"x": recorded(time, value)}, 5.0).check({"x": spec})
    assert reason in str(caught.value)


def test_too_many_messages_that_are_lost_or_late_fail_the_run():
    seen = RecordedSignal(np.array([1.0, 2.0]), np.array([0.0, 0.0]), lost=2, late=1)
    run = Recording({"x": seen}, 5.0)
    run.check({"x": Signal(name="x", topic="/a", field="data", most_lost=3)})
    with pytest.raises(FailedRunError) as caught:
        run.check({"x": Signal(name="x", topic="/a", field="data", most_lost=2)})
    assert str(caught.value) == ("signal x (/a) has 2 lost and 1 late messages, expected at most 2")


def test_a_whole_signal_passes():
    spec = Signal(name="x", topic="/a", field="data", minimum_messages=2, largest_gap=3)
    RECORDING.check({"x": spec})


def test_what_is_counted():
    seen = RecordedSignal(np.array([-1.0, 1.0]), np.array([0.0, 0.0]), lost=3, late=2)
    assert Recording({"x": seen}, 5.0).counts() == {"x": Messages(1, 3, 2)}


@pytest.mark.parametrize(
    ("offset", "side"),
    [(-1.79e9, "1.79e+09 s behind"), (1.79e9, "1.79e+09 s ahead of")],
    ids=["simulated", "of the machine"],
)
def test_a_signal_with_stamps_of_another_clock(offset, side):
    """Its messages come, but none of them lies in the run: that is not silence."""
    # Those that are yet to come are no part of the run.
    times = np.array([offset] if offset < 0.0 else [])
    recording = Recording({"x": RecordedSignal(times, np.ones_like(times), offset=offset)}, 2.0)
    few = {"x": Signal(name="x", topic="/a", field="data")}
    silent = {"x": replace(few["x"], largest_gap=1.0, minimum_messages=0)}
    expected = f"its stamps are {side} the clock of the run: set run.clock to that of the stamps"
    for check in (
        lambda: recording.check(few),
        lambda: recording.check(silent),
        lambda: recording.check_latest(silent, 0.5),
    ):
        with pytest.raises(FailedRunError, match=re.escape(expected)):
            check()


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"minimum_messages": 3}, "signal plan (/plan) has 2 messages in a run of 5 s"),
        ({"largest_gap": 2.0}, "signal plan (/plan) has no message for 3 s from 2.000 s on"),
        ({"most_lost": 2}, "signal plan (/plan) has 3 lost and 0 late messages"),
    ],
)
def test_whole_messages_have_the_same_limits(limits, reason):
    plan = RecordedMessages(np.array([-1.0, 1.0, 2.0]), "a/msg/B", (b"",) * 3, lost=3)
    run = Recording({}, 5.0, {"plan": plan})
    run.check({"plan": Signal(name="plan", topic="/plan")})
    assert run.counts() == {"plan": Messages(2, 3, 0)}
    with pytest.raises(FailedRunError, match=re.escape(reason)):
        run.check({"plan": Signal(name="plan", topic="/plan", **limits)})


def test_what_is_known_of_why_nothing_came_is_told():
    empty = RecordedSignal(np.array([]), np.array([]), remark="there is no frame 'mpa'")
    spec = Signal(name="x", frames=["mpa", "base"], field="translation.x")
    with pytest.raises(FailedRunError, match=r"has 0 messages .*; there is no frame 'mpa'"):
        Recording({"x": empty}, 2.0).check({"x": spec})
