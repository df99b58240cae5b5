"""Between runs, in a pause and after a failure the machine runs with safe parameters."""

import os
import threading

import pytest
from node_threads import at_work
from rclpy.node import Node
from servo import ROOM, SAFE, UNSTABLE, failure, gain, run
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.errors import DisturbedError, LostError
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

GOOD = 0.5
HOME = {"publish": {"topic": "setpoint", "message": {"data": 0.0}}}


def test_after_a_bad_trial_the_machine_is_safe_and_home(backend, system):
    """The step response grows without bounds: |1 - 2.5| > 1, and nothing else brings it back."""
    home = {"wait_until": {"condition": "abs(angle) < 0.01", "timeout": 60.0}}
    made = backend(
        run={"before": [], **ROOM, "recover": [HOME, home]}, park={"parameters": {"gain": SAFE}}
    )
    assert gain(system) == SAFE, "as soon as the backend is open"
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    assert gain(system) == SAFE
    assert abs(system.angle) < 0.01
    assert run(made, GOOD).state is EvaluationState.COMPLETE
    assert gain(system) == GOOD


def test_without_safe_ones_the_defaults_are_safe(backend, system):
    made = backend(run=ROOM)
    failure(run(made, UNSTABLE))
    assert gain(system) == 0.5


def test_in_a_pause(backend, system):
    made = backend(run={"before": []}, park={"parameters": {"gain": SAFE}})
    run(made, 0.75)
    assert gain(system) == 0.75
    assert made.park() == []
    assert gain(system) == SAFE
    assert run(made, 0.75).state is EvaluationState.COMPLETE


def test_between_two_runs_and_while_one_is_prepared(backend, system):
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert (system.gains_at_reset, gain(system)) == ([SAFE], SAFE)


def test_a_preparation_that_fails_with_the_safe_parameters_is_no_fault_of_the_trial(
    backend, system
):
    never = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(
        run={"before": [never], "after": [stop]},
        park={"parameters": {"gain": SAFE}, "between_runs": True},
    )
    outcome = run(made, 0.75)
    assert outcome.unusable
    assert outcome.reason.startswith(
        "the preparation with the safe parameters failed: run.before[0]: 'angle > 9' does not hold"
    )
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_a_preparation_that_somebody_else_made_fail(backend, system):
    moving = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    never = {"wait_until": {"condition": "angle > 9", "timeout": 2.0}}
    made = backend(
        run={"before": [moving, never]}, park={"parameters": {"gain": SAFE}, "between_runs": True}
    )
    values = [0.125]

    def disturb():
        if system.setpoint == 1.0 and values:
            system.set_gain(values.pop())

    with made._tuner.also_watched_by(disturb):
        outcome = run(made, 0.75)
    assert outcome.unusable
    changed = "servo: parameter gain is 0.125, expected 0.25 (changed by someone else)"
    assert outcome.reason.startswith(changed)


def test_a_failure_to_park_is_told(backend, system):
    made = backend(run={"before": [], **ROOM})
    system.refuses_beyond = 2.0
    reason = failure(run(made, UNSTABLE))
    assert reason.startswith("aborted at ")
    assert "; servo is not parked: servo refused its parameters: the key is out" in reason


def test_a_machine_that_does_not_come_home(backend, system):
    home = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    made = backend(run={**ROOM, "recover": [HOME, {"wait": 0.3}, home]})
    reason = failure(run(made, UNSTABLE))
    assert reason.startswith("aborted at ")
    assert (
        "; not recovered: run.recover[2]: 'angle > 9' does not hold for 0.1 s within 0.3 s (angle "
    ) in reason


def test_a_machine_that_does_not_come_home_is_brought_to_rest(backend, system):
    leaving = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    never = {"wait_until": {"condition": "angle > 9", "timeout": 0.3}}
    made = backend(
        run={
            "before": [],
            **ROOM,
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.5}}}],
            "recover": [leaving, never],
        }
    )
    assert "; not recovered: run.recover[1]: " in failure(run(made, UNSTABLE))
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


def test_the_machine_is_stopped_before_the_reason_is_looked_for(backend, system, monkeypatch):
    """A node that hangs is waited for, and one that was started anew; the machine does not wait."""
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], **ROOM, "after": [stop]}, park={"parameters": {"gain": SAFE}})
    found = []

    def note(*_):
        wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
        found.append(gain(system))

    monkeypatch.setattr(made._client.parameters, "expect_answer", note)
    monkeypatch.setattr(made._client, "_refuse_other_nodes", note)
    assert failure(run(made, UNSTABLE)).startswith("aborted at ")
    assert found == [SAFE, SAFE]


def test_a_machine_that_is_not_parked_does_not_drive_home(backend, system):
    """With the parameters of the trial it would."""
    made = backend(run={"before": [], **ROOM, "recover": [HOME]})
    system.refuses_beyond = 2.0
    reason = failure(run(made, UNSTABLE))
    assert "; servo is not parked: servo refused its parameters: the key is out" in reason
    assert system.setpoint == 1.0


class Hanging(Node):
    """Has a gain, too, and answers only while it does not hang."""

    def __init__(self, context):
        super().__init__("hanging", context=context)
        self.declare_parameter("gain", 0.5)
        self.free, self.hangs = threading.Event(), threading.Event()
        self.free.set()
        self.create_timer(0.01, self.hang)

    def hang(self):
        if not self.free.is_set():
            self.hangs.set()
            self.free.wait()


def test_a_node_that_hangs_keeps_no_other_from_being_parked(backend, system):
    """Both are asked at once: the machine is to stop."""
    double = {"type": "double", "bounds": [0.0, 3.0], "default": 0.5}
    with at_work(Hanging) as hanging:
        made = backend(
            nodes={"hanging": {"node": "hanging"}, "servo": {"node": "servo"}},
            parameters={
                "hanging": {"node": "hanging", "parameter": "gain", **double},
                "gain": {"node": "servo", **double},
            },
            run={"before": []},
            park={"parameters": {"gain": SAFE}},
        )
        trial = {"gain": 0.75, "hanging": 0.75}
        outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, trial, {}, 1))
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason

        def look():
            if gain(system) == SAFE:
                hanging.free.set()

        # Asked while nodes are parked, too.
        made._interrupted = look
        hanging.free.clear()
        assert hanging.hangs.wait(DEADLINE)
        try:
            assert made.park() == []
        finally:
            hanging.free.set()
        assert gain(hanging) == 0.5
        made.close()


def test_between_two_runs_the_machine_is_parked_before_the_run_is_judged(
    backend, system, monkeypatch
):
    """A node that was killed is looked for as long as its lease, and a metric takes its time."""
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    found = []

    def noting(owner, name):
        done = getattr(owner, name)
        note = lambda *arguments: found.append(gain(system)) or done(*arguments)  # noqa: E731
        monkeypatch.setattr(owner, name, note)

    noting(made._client, "_refuse_other_nodes")
    noting(made._collector, "outcome")
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert found == [SAFE, SAFE]


@pytest.mark.parametrize("refusals", [1, 2])
def test_a_node_that_is_not_parked_after_a_run_is_told_again_and_then_named(
    backend, system, monkeypatch, refusals
):
    made = backend(park={"parameters": {"gain": SAFE}, "between_runs": True})
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    # It takes the gain of the trial, and not at once the safe one after it.
    answers = [True, *[False] * refusals]
    system.accepts = lambda: answers.pop(0) if answers else True
    outcome = run(made, 0.75)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    problem = "servo is not parked: servo refused its parameters: it is at work"
    assert said == [problem] * (refusals > 1)
    assert bool(outcome.notes.park_problem) == (refusals > 1)
    assert gain(system) == (SAFE if refusals == 1 else 0.75)


def test_a_disturbed_run_is_stopped_before_the_reason_is_looked_for(backend, system, monkeypatch):
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "after": [stop]}, park={"parameters": {"gain": SAFE}})
    found = []

    def disturbed():
        raise DisturbedError("the clock was set")

    def note():
        wait_until(lambda: system.setpoint == -0.5, "the steps after the run")
        found.append(gain(system))

    monkeypatch.setattr(made._procedure._clock, "look", disturbed)
    monkeypatch.setattr(made._client, "_refuse_other_nodes", note)
    assert failure(run(made, 0.75)) == "the clock was set"
    assert found == [SAFE]


def test_a_machine_that_two_command_does_not_drive_home(backend, system, join, leave, monkeypatch):
    """Which of them has the safe parameters is not known."""
    for module in ("study_client", "safe_state"):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{module}.LONGEST_LEASE", 0.1)
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "recover": [home]})
    second = join(Node, "servo")
    servers = made._client.parameters.clients["servo"].servers
    wait_until(lambda: servers() == 2, "both")
    reason = failure(run(made, 0.75))
    twins = f"servo runs more than once in ROS domain {os.environ['ROS_DOMAIN_ID']}"
    # Either of them may answer, so that parking may have failed, too.
    assert reason.startswith(f"{twins}; ")
    leave(second)
    wait_until(lambda: servers() == 1, "the second one is gone")
    made.close()
    assert system.setpoint != -0.5


def test_a_node_that_ends_while_a_second_one_is_waited_for_is_told(backend, system, monkeypatch):
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(run={"before": [], "recover": [home]})

    def twins(_timeout):
        raise LostError("servo has ended")

    monkeypatch.setattr(made._client.presence, "twins", twins)
    outcome = run(made)
    assert outcome.state is EvaluationState.LOST
    assert outcome.reason == "servo has ended; not recovered: servo has ended"
    assert system.setpoint != -0.5


def test_an_objective_without_a_logarithm_leaves_the_machine_safe_and_home(backend, system):
    """That fails an evaluation as all else does."""
    home = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    made = backend(
        objective={"metric": "error", "scale": "log"},
        metrics={"error": {"of": "setpoint - setpoint", "measure": "rms"}},
        run={"before": [], "recover": [home]},
        park={"parameters": {"gain": SAFE}},
    )
    assert failure(run(made, 0.75)) == "metric error is 0.0; its log scale needs a positive value"
    assert gain(system) == SAFE
    wait_until(lambda: system.setpoint == -0.5, "the way home")
