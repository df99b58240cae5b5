"""What others say on a topic that the steps of a study publish."""

import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo import run
from waiting import wait_until

from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

SAID = JointState(name=["a"])
WANTED = {"publish": {"topic": "wanted", "message": {"name": ["a"]}}}
MOVE = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
FOR_LONG = {"start": [MOVE, WANTED], "end": {"after": 1.5}}


class Other(Node):
    """Has a publisher of /wanted, and is silent until it is asked to `say` something."""

    def __init__(self, context):
        super().__init__("intruder", context=context)
        self.publisher = self.create_publisher(JointState, "wanted", 10)

    def say(self):
        self.publisher.publish(SAID)


@pytest.fixture
def other(join):
    """Another node that may publish on /wanted, once the tuner's node is known to it."""

    def make(made):
        found = join(Other)
        own = made._procedure._recorder.node
        listening = own.count_subscribers("wanted")
        wait_until(lambda: own.count_publishers("wanted") > 1, "the other publisher")
        wait_until(lambda: found.publisher.get_subscription_count() >= listening, "its listeners")
        return found

    return make


def test_a_single_message_of_others_disturbs_a_run(backend, other, in_run):
    """Also if it says the same as that of the study."""
    made = backend(run=FOR_LONG)
    assert run(made).state is EvaluationState.COMPLETE
    in_run(made, other(made).say)
    outcome = run(made)
    assert outcome.state is EvaluationState.FAILED
    assert outcome.unusable
    assert outcome.reason.startswith("/intruder published on /wanted in the run, too, which a step")
    assert run(made).state is EvaluationState.COMPLETE


def test_a_publisher_that_is_silent_in_the_run_disturbs_nothing(backend, other):
    made = backend(run=FOR_LONG | {"after": [WANTED]})
    intruder = other(made)
    for _ in range(2):
        intruder.say()
        outcome = run(made)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason


def test_what_only_stops_the_machine_may_be_the_controller_s_own_in_a_run(backend, other, in_run):
    made = backend(run=FOR_LONG | {"start": [MOVE], "after": [WANTED]})
    in_run(made, other(made).say)
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason


@pytest.mark.parametrize("between_runs", [False, True])
def test_a_message_of_others_disturbs_the_preparation(backend, other, system, between_runs):
    near = {"wait_until": {"condition": "angle < -5", "timeout": 1.0}}
    made = backend(
        run={"before": [WANTED, near]},
        park={"between_runs": between_runs},
    )
    intruder = other(made)
    said = []

    def say():
        if system.received and not said:
            said.append(intruder.say())

    with made._tuner.also_watched_by(say):
        outcome = run(made)
    assert said
    assert outcome.unusable
    assert "/intruder published on /wanted in the run, too" in outcome.reason
