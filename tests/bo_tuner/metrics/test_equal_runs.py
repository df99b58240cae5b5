"""What two equal runs tell of a study: that nothing moves, or that they do not start alike."""

import numpy as np
import pytest
from signal_runs import signal_study

from bo_tuner.metrics.equal_runs import (
    AsIfStill,
    OfRunBefore,
    UnlikeStart,
    all_stand,
    from_the_run_before,
    standing,
    uneven_rates,
    unlike_starts,
    unmoved,
)
from bo_tuner.metrics.message_rates import rate_of
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.processor_load import Load
from bo_tuner.study.study_file import study_from_mapping

TIME = np.arange(-0.01, 2.0, 0.01)
STEP = RecordedSignal(np.array([-0.5, 0.001]), np.array([0.0, 1.0]))
HEARD = ["angle"]


def seen(value):
    return RecordedSignal(TIME, np.broadcast_to(value, TIME.shape).astype(float))


def run(angle, **others):
    return Recording({"setpoint": STEP, "angle": seen(angle)} | others, 2.0)


@pytest.fixture
def study():
    return study_from_mapping(
        signal_study(
            signals={
                "setpoint": {"topic": "setpoint", "field": "data"},
                "angle": {"topic": "angle", "field": "data"},
            },
            metrics={
                "error": {"of": "setpoint - angle", "measure": "iae"},
                "rest": {
                    "of": "angle",
                    "measure": "steady_state_error",
                    "target": "setpoint",
                },
            },
            objective={"metric": "error"},
            constraints={},
            run={"end": {"after": 2.0}},
        )
    )


def response(rate=5.0):
    """A step response from rest, [0, 1)."""
    return np.where(TIME < 0.0, 0.0, 1.0 - np.exp(-rate * np.maximum(TIME, 0.0)))


def noise(size, seed):
    return size * np.random.default_rng(seed).standard_normal(TIME.shape)


def test_a_signal_that_keeps_one_value_in_both_runs():
    runs = [run(0.25, speed=seen(response()))] * 2
    assert standing(runs, ["angle", "speed"]) == ["angle"]
    assert not all_stand(runs, ["angle", "speed"])
    assert all_stand(runs, HEARD)
    assert standing([run(0.0), run(0.25)], HEARD) == []


def test_a_result_that_comes_once_in_a_run_may_be_the_same_in_both():
    score = RecordedSignal(np.array([1.0]), np.array([7.0]))
    runs = [run(response(), score=score)] * 2
    assert standing(runs, ["angle", "score"]) == []
    assert not all_stand([Recording({"score": score}, 2.0)] * 2, ["score"])


def test_a_machine_that_stands_still_in_noise(study):
    assert [*unmoved(study, run(noise(1e-3, 1)), HEARD)] == [
        AsIfStill("error", ("angle",)),
        AsIfStill("rest", ("angle",)),
    ]
    for rate in (0.1, 5.0):
        moving = run(response(rate) + noise(1e-3, 1))
        assert list(unmoved(study, moving, HEARD)) == []


def test_a_reference_that_does_not_step_asks_for_no_motion(study):
    still = RecordedSignal(np.array([-0.5]), np.array([0.0]))
    recording = Recording({"setpoint": still, "angle": seen(0.0)}, 2.0)
    assert list(unmoved(study, recording, HEARD)) == []


@pytest.mark.parametrize("left", [0.9, -0.3, 0.15])
def test_a_run_that_begins_while_the_last_one_swings(left):
    swinging = response() + left * np.cos(20.0 * TIME) * np.exp(-TIME)
    assert [*unlike_starts([run(response()), run(swinging)], HEARD)] == [
        UnlikeStart("angle", 2, swinging[0], 0.0)
    ]


@pytest.mark.parametrize(
    "other",
    [
        response(),
        # The message that starts it comes later.
        np.interp(TIME - 0.3, TIME, response()),
        response() + 0.02,
        response() + noise(0.02, 3),
    ],
)
def test_runs_that_begin_alike(other):
    first = response() + (noise(0.02, 2) if np.ptp(other) > 1.01 else 0.0)
    assert list(unlike_starts([run(first), run(other)], HEARD)) == []


@pytest.mark.parametrize("seed", range(20))
def test_runs_that_are_all_noise_begin_alike(seed):
    runs = [run(noise(1.0, 2 * seed + k)) for k in range(2)]
    assert list(unlike_starts(runs, HEARD)) == []


def every(*distances):
    """A run of 2 s with a signal in some distances [s], by turns."""
    times = np.cumsum(np.resize(distances, round(2.0 / np.mean(distances))))
    return Recording({"angle": RecordedSignal(times, times)}, 2.0)


def uneven(recordings, loads=None):
    rates = [{name: rate_of(each.signals[name], each.end) for name in HEARD} for each in recordings]
    runs = [f"run {k}" for k in range(1, len(recordings) + 1)]
    return list(uneven_rates(runs, rates, loads or [None] * len(runs)).values())


@pytest.mark.parametrize("first", [0.008, 0.014])
def test_messages_that_come_less_often_in_one_of_two_equal_runs(first):
    runs = [every(first), every(0.02)]
    (found,) = uneven(runs, [None, Load(0.0, 0.1)])
    assert (found.signal, found.seldom, found.often) == ("angle", "run 2", "run 1")
    assert (found.least, found.most) == pytest.approx((50.0, 1.0 / first), rel=0.02)
    assert found.waited is None
    (found,) = uneven(runs, [None, Load(0.9, 0.4)])
    assert found.waited == 0.4


def test_a_single_run_of_many_is_remarked_on_by_itself():
    assert uneven([every(0.02)] * 60 + [every(0.04)]) == []
    assert len(uneven([every(0.02)] * 60 + [every(0.04)] * 3)) == 1


@pytest.mark.parametrize(
    "runs",
    [
        [every(0.02), every(0.0205)],
        # Events, and too few messages to tell.
        [every(0.001, 0.001, 0.001, 0.1), every(0.001, 0.001, 0.001, 0.3)],
        [every(0.3), every(0.6)],
    ],
)
def test_messages_that_come_as_often_or_of_events(runs):
    assert uneven(runs) == []


@pytest.mark.parametrize(("age", "told"), [(5.0, 1), (0.01, 0)])
def test_a_signal_that_is_published_in_runs_only(age, told):
    """Between runs it is silent; what was only not heard yet before run 1 goes on at its rate."""
    in_run = TIME[TIME >= 0.0]
    first, last = in_run, np.concatenate([[-age], in_run])
    runs = [
        Recording({"setpoint": STEP, "angle": RecordedSignal(time, np.ones(time.shape))}, 2.0)
        for time in (first, last)
    ]
    assert [*from_the_run_before(runs, HEARD)] == [OfRunBefore("angle", 2)] * told


def test_a_signal_of_single_messages_that_is_published_in_runs_only():
    runs = [
        run(0.0, result=RecordedSignal(np.array(time), np.ones(len(time))))
        for time in ([1.0], [-4.0, 1.0])
    ]
    assert [*from_the_run_before(runs, ["result"])] == [OfRunBefore("result", 2)]
