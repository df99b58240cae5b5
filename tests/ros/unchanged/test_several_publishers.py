"""Topics with several publishers: of one node, of the one that the study names, or of all."""

from functools import partial

import pytest
from field_robot import Driver, Joints, Wheels
from servo import failure, run
from waiting import wait_until

from bo_tuner.backends.ros import heard_topic, procedure, publishers, taking
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

SPEED = {"topic": "cmd_vel", "field": "linear.x"}
RANGE = {
    "least": {"of": "speed", "measure": "minimum"},
    "most": {"of": "speed", "measure": "maximum"},
}
RUN = {"end": {"after": 0.6}}


def opened(backend, signals, metrics=RANGE, **others):
    return backend(signals=signals, metrics=metrics, run=RUN, **others)


def metrics(made):
    """What runs come to; on a busy machine one may be disturbed."""
    for _ in range(3):
        found = run(made)
        if found.state is EvaluationState.COMPLETE:
            return found.metrics
    raise AssertionError(found.reason)


def test_several_publishers_of_one_node_belong_together(backend, join):
    """As the behaviours of Nav2's behavior_server, each of which has a publisher of /cmd_vel."""
    join(partial(Driver, publishers=4))
    made = opened(backend, {"speed": SPEED})
    found = metrics(made)
    assert (found["least"], found["most"]) == (1.0, 1.0)
    assert made.recording.signals["speed"].messages > 20


def test_of_several_nodes_none_is_taken_by_accident(refusal, join):
    join(partial(Driver, name="smoother"))
    join(partial(Driver, name="joystick"))
    expected = (
        r"signals.speed.topic: /cmd_vel has 2 publishers (joystick and smoother), whose messages "
        "would mix; name one of them by publisher, or take all by merge: true"
    )
    assert refusal(signals={"speed": SPEED}) == expected


def test_the_messages_of_one_node_among_several(backend, join):
    """Each signal has those of its own node, and the losses of the others are none of its."""
    join(partial(Driver, name="smoother", value=0.5, publishers=2))
    join(partial(Driver, name="joystick", value=-2.0))
    made = opened(
        backend,
        {
            "speed": SPEED | {"publisher": "/smoother"},
            "wish": SPEED | {"publisher": "joystick"},
        },
        RANGE | {"wished": {"of": "wish", "measure": "maximum"}},
    )
    found = metrics(made)
    assert (found["least"], found["most"], found["wished"]) == (0.5, 0.5, -2.0)
    seen = made.recording.signals
    assert seen["speed"].messages > 20
    assert (seen["speed"].lost, seen["wish"].lost) == (0, 0)


def test_a_node_that_does_not_publish_the_topic(refusal, join):
    join(partial(Driver, name="smoother"))
    expected = (
        "signals.speed.publisher: /smoothen does not publish /cmd_vel; expected one of smoother"
    )
    assert refusal(signals={"speed": SPEED | {"publisher": "smoothen"}}) == expected


def test_a_named_node_that_runs_twice_is_mixed(backend, refusal, join):
    for _ in range(2):
        join(partial(Driver, name="smoother"))
    assert "/cmd_vel has 2 publishers in smoother (smoother and smoother), whose messages" in (
        refusal(signals={"speed": SPEED | {"publisher": "smoother"}})
    )


def test_a_named_node_that_leaves_and_comes_back(backend, join, leave, monkeypatch):
    """Others go on publishing; the runs of that time are lost, and not the parameters' fault."""
    monkeypatch.setattr(procedure, "DISCOVERED", 0.3)
    smoother = join(partial(Driver, name="smoother", value=0.5))
    join(partial(Driver, name="joystick", value=-2.0))
    made = opened(backend, {"speed": SPEED | {"publisher": "smoother"}})
    assert metrics(made)["most"] == 0.5
    leave(smoother)
    wait_until(lambda: made._procedure._recorder.unpublished, "it is gone")
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.reason.startswith("/cmd_vel is not published by smoother any more")
    join(partial(Driver, name="smoother", value=0.75))
    wait_until(lambda: not made._procedure._recorder.unpublished, "it is back")
    assert metrics(made)["most"] == 0.75


def test_a_node_that_joins_disturbs_a_signal_of_one_node_only(backend, join, leave, monkeypatch):
    monkeypatch.setattr(procedure, "LONGEST_LEASE", 0.5)
    join(partial(Driver, name="smoother", value=0.5))
    made = opened(backend, {"speed": SPEED})
    other = join(partial(Driver, name="joystick", value=-2.0))
    wait_until(lambda: made._procedure._recorder.mixed, "the other one is found")
    found = run(made)
    assert found.unusable
    assert found.reason == "/cmd_vel has 2 publishers, whose messages mix"
    made.close()
    leave(other)
    made = opened(backend, {"speed": SPEED | {"merge": True}})
    join(partial(Driver, name="joystick", value=-2.0))
    wait_until(lambda: made._procedure._recorder._topics["/cmd_vel"].publishers == 2, "it is back")
    found = metrics(made)
    assert (found["least"], found["most"]) == (-2.0, 0.5)


def test_merged_joints_of_an_arm_and_a_gripper(backend, join):
    """A message without the joint of a signal is of the other node, and no fault."""
    join(partial(Joints, "arm", {"elbow": 1.0}))
    join(partial(Joints, "gripper", {"finger": 0.25}))
    joints = {"topic": "all_joints", "merge": True}
    made = opened(
        backend,
        {
            "speed": joints | {"field": "position[elbow]"},
            "finger": joints | {"field": "position[finger]"},
        },
        RANGE | {"grip": {"of": "finger", "measure": "mean"}},
    )
    found = metrics(made)
    assert (found["least"], found["most"], found["grip"]) == (1.0, 1.0, 0.25)


def test_a_joint_that_none_of_them_has(refusal, join):
    join(partial(Joints, "arm", {"elbow": 1.0}))
    join(partial(Joints, "gripper", {"finger": 0.25}))
    wrist = {"topic": "all_joints", "merge": True, "field": "position[wrist]"}
    assert "a message on /all_joints has no 'wrist' among its names" in refusal(
        signals={"speed": wrist}
    )


def test_a_middleware_that_does_not_say_of_whom_a_message_is(backend, join, monkeypatch):
    """Nothing is taken for the wrong node's; the run fails by name."""
    join(partial(Driver, name="smoother"))
    monkeypatch.setattr(publishers.Publishers, "name_of", lambda self, gid: "")
    made = opened(backend, {"speed": SPEED | {"publisher": "smoother"}})
    reason = failure(run(made))
    assert "signal speed (cmd_vel) has 0 messages" in reason
    assert "does not tell of which publisher a message is" in reason


def test_without_the_library_a_named_node_is_refused(refusal, join, monkeypatch):
    join(partial(Driver, name="smoother"))
    monkeypatch.setattr(heard_topic, "taker", lambda subscription, _: taking.Taker(subscription))
    assert "does not tell of which publisher a message is; expected one publisher" in refusal(
        signals={"speed": SPEED | {"publisher": "smoother"}}
    )


def test_a_topic_that_the_study_zeroes_in_the_end(backend, join):
    """The tuner's own publisher is one more; what it says after a run is not of the signal."""
    join(partial(Driver, name="smoother", value=0.5))
    join(Wheels)
    stop = {"publish": {"topic": "cmd_vel", "message": {"linear": {"x": 0.0}}}}
    made = backend(
        signals={"speed": SPEED | {"publisher": "smoother"}},
        metrics=RANGE,
        run=RUN | {"before": [{"wait": 0.1}], "after": [stop]},
    )
    for _ in range(2):
        found = metrics(made)
        assert (found["least"], found["most"]) == (0.5, 0.5)
