"""Ctrl-C stops the machine first, and nothing moves it after that."""

import pytest
from servo import ROOM, UNSTABLE, failure, gain, run
from waiting import DEADLINE, wait_until

from bo_tuner.backends.layers import suspension
from bo_tuner.backends.ros.errors import DisturbedError
from bo_tuner.interruption import Interrupted

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("phase", ["before", "start"])
def test_an_interrupted_run_stops_the_machine_ahead_of_all_else(
    interruptible, system, monkeypatch, phase
):
    """As Ctrl-C does, when it moves: not only when the backend is closed, after the records."""
    moving = [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}, {"wait": DEADLINE}]
    steps = {
        "before": [],
        "start": [],
        "end": {"after": 2 * DEADLINE},
        "timeout": 2 * DEADLINE,
        "after": [
            {"call": {"service": "servo/enable", "request": {"data": False}}},
            {"publish": {"topic": "setpoint", "message": {"data": -0.5}}},
        ],
    }
    made = interruptible(lambda: system.setpoint == 1.0, run=steps | {phase: moving})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    with pytest.raises(Interrupted):
        run(made, 0.75)
    # The first of the steps is refused, which does not keep the next one from being done.
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
    assert gain(system) == 0.5
    # It has no other record.
    assert said == ["run.after[0]: /servo/enable refused: the brake is on"]


def test_a_node_that_is_not_parked_after_an_interruption_is_told(
    interruptible, system, monkeypatch
):
    moving = [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}, {"wait": DEADLINE}]
    made = interruptible(lambda: system.setpoint == 1.0, run={"before": moving})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    system.accepts = lambda: system.setpoint != 1.0
    with pytest.raises(Interrupted):
        run(made, 0.75)
    assert said == ["servo is not parked: servo refused its parameters: it is at work"]
    system.accepts = lambda: True


def test_an_interruption_ahead_of_an_evaluation_sets_nothing(interruptible, system):
    """The parameters of a trial that is not to be run reach no node."""
    interrupting = []
    made = interruptible(lambda: interrupting, run={"before": []})
    interrupting.append(True)
    asked = system.asked_to_set
    with pytest.raises(Interrupted):
        run(made, 0.75)
    assert system.asked_to_set == asked


def test_an_interruption_of_a_suspended_tuner_keeps_a_run_from_being_repeated(
    interruptible, system, monkeypatch
):
    """Of the parameters it has shown nothing."""
    interrupting, passed = [], [0.0]
    made = interruptible(lambda: interrupting, run={"before": [], **ROOM})
    now, evaluate = made._suspension._clock, made._client.evaluate
    monkeypatch.setattr(made._suspension, "_clock", lambda: now() + passed[0])

    def suspended(*arguments):
        try:
            return evaluate(*arguments)
        finally:
            passed[0] += 2 * suspension.LONGEST
            interrupting.append(True)

    monkeypatch.setattr(made._client, "evaluate", suspended)
    with pytest.raises(Interrupted):
        run(made, UNSTABLE)
    assert len(interrupting) == 1


def test_what_a_run_has_shown_is_kept_when_the_way_home_is_interrupted(interruptible, system):
    """The parameters are not run again, and the machine does not go on driving."""
    leaving = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    made = interruptible(
        lambda: system.setpoint == 0.25,
        run={
            "before": [],
            **ROOM,
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}],
            "recover": [leaving, {"wait": DEADLINE}],
        },
    )
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_an_interruption_while_a_machine_is_stopped_keeps_it_from_driving_home(
    interruptible, system, monkeypatch
):
    """It does not end the steps after the run, but what follows on them."""
    rest = {"wait_until": {"condition": "angle < -0.2", "timeout": DEADLINE}}
    made = interruptible(
        lambda: system.setpoint == -0.5,
        run={
            "before": [],
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}, rest],
            "recover": [{"publish": {"topic": "setpoint", "message": {"data": 0.25}}}],
        },
    )
    published, publisher = [], made._procedure._topics["/setpoint"].publisher
    publish = publisher.publish

    def noting(message):
        published.append(message.data)
        publish(message)

    def disturbed():
        if made._procedure._is_recording:
            raise DisturbedError("the clock was set")

    publisher.publish = noting
    monkeypatch.setattr(made._procedure._clock, "look", disturbed)
    assert failure(run(made)).startswith("the clock was set")
    assert set(published) == {1.0, -0.5}


def test_a_function_of_a_metric_is_ended_and_the_machine_is_safe_before_it_begins(
    interruptible, system, tmp_path
):
    """It may take any time, in which even a tuner that is killed leaves no trial's gains."""
    (tmp_path / "looping_metric.py").write_text(
        "def loop(signals):\n    open('begun', 'w').close()\n    while True: pass\n"
    )
    gains = []

    def computing():
        if (tmp_path / "begun").exists():
            gains.append(gain(system))
        return gains

    made = interruptible(
        computing, metrics={"own": {"python": "looping_metric:loop"}}, folder=str(tmp_path)
    )
    with pytest.raises(Interrupted):
        run(made, 0.75)
    assert gains[0] == 0.5
