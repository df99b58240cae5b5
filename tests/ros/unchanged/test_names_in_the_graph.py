"""Signals and steps of a study are looked up among topics and services ahead of the first run."""

from functools import partial

import pytest
from node_threads import at_work
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from servo import run
from std_msgs.msg import Float64, Int32
from waiting import wait_until

from bo_tuner.errors import StudyError
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("signals", "complaint"),
    [
        ({"topic": "/joint_staets"}, "topic: nothing publishes /joint_staets; did you mean '/j"),
        ({"topic": "twice", "field": "data"}, "topic: /twice has 2 publishers (idle and servo)"),
        ({"type": "std_msgs/msg/Float64"}, "type: /joint_states carries sensor_msgs/msg/Joint"),
        ({"field": "positon[motor]"}, "no field 'positon'; did you mean 'position'?"),
        (
            {"field": "position[moto]"},
            "field: a message on /joint_states has no 'moto' among its names; did you mean 'motor",
        ),
        ({"field": "position"}, "position is an array; name one item, such as position[0] or"),
        ({"field": "name[0]"}, "field: name is text; expected a number"),
        ({"field": "header.stamp"}, "header.stamp is a builtin_interfaces/msg/Time; name one"),
        ({"field": "header.stamp[0]"}, "header.stamp is no array; leave out [0]"),
        ({"field": "header.stamp.sec.x"}, "header.stamp.sec is a number and has no fields"),
        ({"topic": "plain", "field": "data[x]"}, "data has no array of names beside it"),
        ({"topic": "plain", "field": "data[0]", "time": "header"}, "time: std_msgs/msg/Float64"),
    ],
)  # fmt: skip
def test_a_signal_that_cannot_be_had(refusal, signals, complaint):
    angle = {"topic": "joint_states", "field": "position[motor]"} | signals
    reason = refusal(signals={"angle": angle})
    assert reason.startswith("signals.angle.")
    assert complaint in reason


@pytest.mark.parametrize(
    ("step", "complaint"),
    [
        ({"call": {"service": "servo/rest"}}, "call.service: there is no service /servo/rest; did"),
        (
            {"call": {"service": "servo/enable", "request": {"dat": True}}},
            "call.request.dat: std_srvs/srv/SetBool_Request has no field 'dat'; did you",
        ),
        (
            {"call": {"service": "servo/enable", "request": {"data": 1}}},
            "call.request.data: expected true or false, found 1",
        ),
        (
            {"publish": {"topic": "nobody", "message": {}}},
            "publish.topic: nothing subscribes to /nobody",
        ),
        (
            {"publish": {"topic": "setpoint", "type": "std_msgs/msg/Int32", "message": {}}},
            "publish.type: /setpoint carries std_msgs/msg/Float64; expected std_msgs/msg/Int32",
        ),
        (
            {"publish": {"topic": "setpoint", "message": {"data": "fast"}}},
            "publish.message.data: expected a number, found text 'fast'",
        ),
        (
            {"publish": {"topic": "wanted", "message": {"position": [1.0, "x"]}}},
            "publish.message.position[1]: expected a number",
        ),
        (
            {"publish": {"topic": "wanted", "message": {"header": {"stamp": {"nanosec": -1}}}}},
            "publish.message.header.stamp.nanosec: expected an integer from 0 to 4294967295",
        ),
    ],
)
def test_a_step_that_cannot_be_done(refusal, step, complaint):
    assert refusal(run={"before": [step]}).startswith(f"run.before[0].{complaint}")


@pytest.fixture
def of_another_type():
    """A node, of another process, that takes another message on /setpoint."""

    def make(context):
        node = Node("monitor", context=context)
        node.create_subscription(Int32, "setpoint", lambda message: None, 10)
        return node

    with at_work(make) as node:
        yield node


TO_ALL = {"topic": "setpoint", "message": {"data": 1.0}}


@pytest.mark.usefixtures("of_another_type")
def test_a_topic_with_messages_of_two_types(backend):
    reasons = []

    def refused():
        """Once both are discovered; before, there is one to be published."""
        try:
            backend(run={"start": [{"publish": TO_ALL}]})
        except StudyError as error:
            reasons.append(str(error))
        backend.opened[-1].close()
        return bool(reasons)

    wait_until(refused, "both subscribers")
    assert reasons == [
        "run.start[0].publish.type: /setpoint carries std_msgs/msg/Float64 and "
        "std_msgs/msg/Int32; name one of them"
    ]


@pytest.mark.usefixtures("of_another_type")
def test_of_two_types_the_one_that_is_named(backend, system):
    typed = {"publish": TO_ALL | {"type": "std_msgs/msg/Float64"}}
    made = backend(run={"start": [typed], "end": {"when": "angle > 0.9"}})
    assert run(made).state is EvaluationState.COMPLETE
    assert system.setpoint == 1.0


def test_a_subscriber_that_cannot_hear_is_named(refusal, join):
    watchdog = join(partial(Node, "watchdog"))
    qos = QoSProfile(depth=1, deadline=Duration(seconds=0.1))
    watchdog.create_subscription(Float64, "watched", lambda message: None, qos)
    reason = refusal(run={"before": [{"publish": {"topic": "watched", "message": {}}}]})
    assert reason.startswith(
        "run.before[0].publish.topic: /watchdog cannot hear what is published on /watched: "
    )
    assert "deadline" in reason
