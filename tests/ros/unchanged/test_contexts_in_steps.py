"""Contexts without a node: values in the steps of a run, by their names in braces."""

import pytest
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from servo import failure
from std_msgs.msg import String

from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

CONTEXTS = {
    "goal": {"distribution": "uniform", "bounds": [-1.0, 1.0], "nominal": 0.5},
    "brake": {"distribution": "discrete", "values": [True, False]},
    "room": {"distribution": "discrete", "values": ["office", "yard", "garage"]},
}
RUN = {
    "before": [
        {"call": {"service": "servo/reset"}},
        {"publish": {"topic": "place", "message": {"data": "load {room}.yaml"}}},
        {"call": {"service": "servo/enable", "request": {"data": "{brake}"}}},
    ],
    "start": [
        {"publish": {"topic": "setpoint", "message": {"data": "{goal}"}}},
        {"wait_until": {"condition": "abs(angle - {goal}) < 0.01", "hold": 0.05}},
    ],
    "end": {"when": "abs(angle - {goal}) < 0.005 and t > 0.1"},
}


class Place(Node):
    """Keeps what it is told on /place."""

    def __init__(self, context):
        super().__init__("place", context=context)
        self.told = []
        self.create_subscription(String, "place", lambda m: self.told.append(m.data), 10)


@pytest.fixture
def place(join):
    return join(Place)


def run_in(backend, goal, brake=True, room="yard"):
    context = {"goal": goal, "brake": brake, "room": room}
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, context, 1))


def test_each_run_has_those_of_its_context(backend, system, place):
    made = backend(run=RUN, contexts=CONTEXTS)
    for goal, room in ((-0.75, "yard"), (0.5, "office"), (0.25, "garage")):
        outcome = run_in(made, goal, room=room)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason
        assert system.setpoint == goal
        assert abs(system.angle - goal) < 0.01
        assert place.told[-1] == f"load {room}.yaml"
    assert len(place.told) == 3


def test_a_stream_has_those_of_its_context(backend, system):
    """In its expressions, and what it is held at after the run in the safe value of the gain."""
    stream = {"topic": "setpoint", "rate": 50, "largest_gap": 60.0}
    start = [{"publish": stream | {"profile": {"data": "{goal} + 0 * t"}}}]
    after = [{"publish": stream | {"profile": {"data": "-{gain}"}, "duration": 0.1}}]
    made = backend(
        run={"start": start, "end": {"after": 0.3}, "after": after},
        contexts={"goal": CONTEXTS["goal"]},
        metrics={"set": {"of": "setpoint", "measure": "maximum"}},
        objective={"metric": "set"},
    )
    for goal in (-0.25, 0.75):
        outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 0.75}, {"goal": goal}, 1))
        assert outcome.metrics["set"] == goal, outcome.reason
        assert system.setpoint == -0.5


def test_a_service_gets_a_truth_value(backend, place):
    made = backend(run=RUN, contexts=CONTEXTS)
    assert failure(run_in(made, 0.5, brake=False)).endswith("servo/enable refused: the brake is on")
    assert run_in(made, 0.5).state is EvaluationState.COMPLETE


def test_a_wait_that_fails_says_for_which_value(backend, place):
    wait = {"condition": "angle > {goal} + 5", "timeout": 0.3, "hold": 0.1}
    made = backend(
        run=RUN | {"before": [{"wait_until": wait}]}, contexts={"goal": CONTEXTS["goal"]}
    )
    outcome = made.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {"goal": -0.5}, 1))
    assert "'angle > (-0.5) + 5' does not hold for 0.1 s" in failure(outcome)


def test_what_a_field_cannot_hold_is_refused_at_once(refusal, place):
    start = [{"publish": {"topic": "place", "message": {"data": "{goal}"}}}]
    reason = refusal(run={"start": start}, contexts={"goal": CONTEXTS["goal"]})
    assert reason == "run.start[0].publish.message.data: expected text, found 0.5"


def test_what_only_some_values_do_to_a_field_is_refused_at_once(refusal):
    level = {"type": "integer", "distribution": "uniform", "bounds": [0, 2**40], "nominal": 7}
    start = [{"publish": {"topic": "wanted", "message": {"header": {"stamp": {"sec": "{level}"}}}}}]
    reason = refusal(run={"start": start}, contexts={"level": level})
    assert reason.startswith(
        "run.start[0].publish.message.header.stamp.sec: expected an integer from -2147483648 to "
    )


class Drive(Node):
    """Has a gain that the study sets by a service call, and keeps what it was given."""

    def __init__(self, context):
        super().__init__("drive", context=context)
        self.declare_parameter("kp", 1.0)
        self.given = []
        self.add_on_set_parameters_callback(self.take)

    def take(self, parameters):
        self.given += [item.value for item in parameters]
        return SetParametersResult(successful=True)


def gains(value):
    request = {"parameters": [{"name": "kp", "value": {"type": 3, "double_value": value}}]}
    return {"call": {"service": "drive/set_parameters", "request": request}}


def test_a_tuned_gain_goes_by_a_service_call_and_the_safe_one_after_the_run(backend, join):
    drive = join(Drive)
    parameters = {
        "gain": {"node": "servo", "type": "double", "bounds": [0.05, 1.0], "default": 0.5},
        "kp": {"type": "double", "bounds": [0.0, 4.0], "default": 1.5},
    }
    run = {
        "before": [{"call": {"service": "servo/reset"}}, gains("{kp}")],
        "start": [{"publish": {"topic": "setpoint", "message": {"data": 0.5}}}],
        "end": {"after": 0.3},
        "after": [gains("{kp}")],
    }
    made = backend(run=run, parameters=parameters, park={"parameters": {"kp": 0.25}})
    drive.given.clear()
    for kp in (3.0, 2.0):
        planned = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5, "kp": kp}, {}, 1)
        outcome = made.outcome(planned)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert drive.given == [3.0, 0.25, 2.0, 0.25]
