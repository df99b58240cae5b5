"""References that stream while the steps of a run go on."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from servo import Sensor, failure, run
from servo import study as servo_study
from signal_runs import SETPOINT
from std_msgs.msg import Float64, Float64MultiArray, UInt8
from trajectory_msgs.msg import JointTrajectory
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros import streams
from bo_tuner.backends.ros.clock import to_stamp
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.run_notes import Unusable
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

RATE, GAP = 50.0, 60.0
HELD = {"rate": RATE, "largest_gap": GAP}
"""A busy machine may be late; what that means is tested by itself."""
ANGLE = {"topic": "/joint_states", "field": "position[motor]", "time": "reception"}


class Listener(Node):
    """Takes references of several kinds down, each with the time [s] at which it came."""

    def __init__(self, context):
        super().__init__("listener", context=context)
        self.heard = {}
        for kind, topic in (
            (Float64, "left"), (Float64, "right"), (TwistStamped, "twist"), (UInt8, "byte"),
            (JointTrajectory, "trajectory"), (Float64MultiArray, "array"),
        ):  # fmt: skip
            self.heard[topic] = []
            self.create_subscription(kind, topic, self.heard[topic].append, 1000)

    def numbers(self, topic):
        return [message.data for message in self.heard[topic]]


@pytest.fixture
def listener(join):
    return join(Listener)


@pytest.fixture
def patient(patient, monkeypatch):
    """Streams have all the time that a busy machine takes, too."""
    monkeypatch.setattr(streams, "MOST_LEFT_OUT", 1.0)
    monkeypatch.setattr(streams, "UNSERVED", DEADLINE)


STILL = [
    {"call": {"service": "servo/reset"}},
    {"publish": {"topic": "setpoint", "message": {"data": 0.0}}},
]


@pytest.fixture
def backend(backend):
    """Function that opens a backend for a study whose machine is at rest unless it moves it."""

    def make(run, **sections):
        setpoint = SETPOINT | {"minimum_messages": 0}
        signals = {"setpoint": setpoint} | sections.pop("signals", {})
        run = run | {"before": STILL + run.get("before", [])}
        return backend(run=run, signals=signals, **sections)

    return make


def stream(topic, profile, **others):
    return {"publish": HELD | {"topic": topic, "profile": {"data": profile}} | others}


def complete(outcome):
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    return outcome


def test_a_reference_goes_on_while_steps_are_performed(backend, listener):
    """Each message says what the profile comes to at its own time, whatever was left out."""
    call = {"call": {"service": "servo/reset"}}
    steps = [stream("left", "1 + t"), {"wait": 0.2}, call, {"wait": 0.2}]
    made = backend(run={"start": steps, "end": {"when": "t > 0.6"}})
    outcome = complete(run(made))
    told = outcome.notes.streams["/left"]
    wait_until(lambda: len(listener.heard["left"]) == told.messages, "all messages")
    heard = listener.numbers("left")
    numbers = (np.array(heard) - 1.0) * RATE
    assert numbers == pytest.approx(np.round(numbers), abs=1e-6)
    assert numbers[0] == pytest.approx(0.0)
    assert (np.diff(numbers) > 0.5).all()
    # It went on after the second wait, up to the end of the run.
    assert heard[-1] > 1.4
    assert told.startswith(f"{len(heard)} messages, {round(numbers[-1]) + 1 - len(heard)} left out")


def test_a_reference_ends_with_the_run(backend, listener):
    made = backend(run={"start": [stream("left", "t")], "after": [{"wait": 0.3}]})
    complete(run(made))
    first = len(listener.heard["left"])
    time.sleep(0.2)
    assert len(listener.heard["left"]) == first
    complete(run(made))
    # It begins anew.
    assert listener.numbers("left")[first] == 0.0


def test_the_latest_step_on_a_topic_counts(backend, listener):
    """One that holds the machine before a run goes over into that of the run without a break."""
    made = backend(
        run={
            "before": [stream("left", "-1 + 0 * t"), {"wait": 0.1}],
            "start": [
                stream("left", "t"),
                {"wait": 0.1},
                {"publish": {"topic": "left", "message": {"data": 7.0}}},
            ],
        }
    )
    complete(run(made))
    heard = listener.numbers("left")
    begun = heard.index(0.0)
    assert begun > 0
    assert set(heard[:begun]) == {-1.0}
    assert heard[-1] == 7.0
    assert heard.count(7.0) == 1
    assert all(0.0 <= value < 5.0 for value in heard[begun:-1])


def test_a_reference_that_is_stopped(backend, listener):
    topics = [{"topic": topic, "profile": {"data": "t"}} for topic in ("left", "right")]
    both = {"publish": HELD | {"topics": topics}}
    made = backend(
        run={
            "start": [both, {"wait": 0.1}, {"stop": "left"}, {"wait": 0.2}, {"stop": "/right"}],
            "end": {"when": "t > 0.5"},
        }
    )
    complete(run(made))
    left, right = listener.numbers("left"), listener.numbers("right")
    assert right[: len(left)] == left
    assert right[-1] >= 0.2 > 0.1
    assert len(right) > len(left)


def test_a_reference_that_comes_to_its_end(backend, listener):
    ramp = {"ramp": {"final": 3.0, "duration": 0.2}}
    made = backend(run={"start": [stream("left", ramp, duration=0.3)], "end": {"when": "t > 0.5"}})
    outcome = complete(run(made))
    heard = listener.numbers("left")
    assert heard[-1] == pytest.approx(3.0)
    assert len(heard) <= 16
    assert outcome.notes.streams["/left"].messages == len(heard)


def test_messages_of_several_types_in_step(backend, listener):
    point = {"time_from_start": {"nanosec": 20_000_000}}
    topics = [
        {"topic": "twist", "profile": {"twist.linear.x": "t", "twist.angular.z": "-t"}},
        {
            "topic": "trajectory",
            "message": {"joint_names": ["a", "b"], "points": [point]},
            "profile": {"points[0].positions[1]": "2 * t", "points[0].positions[0]": "t"},
        },
        {"topic": "array", "profile": {"data[2]": "t"}},
        {"topic": "byte", "profile": {"data": "10.4 + min(100 * t, 200)"}},
    ]
    made = backend(run={"start": [{"publish": HELD | {"topics": topics}}]})
    complete(run(made))
    heard = listener.heard
    wait_until(lambda: len({len(heard[item["topic"]]) for item in topics}) == 1, "all messages")
    times = [message.twist.linear.x for message in heard["twist"]]
    assert len(times) > 2
    assert [message.twist.angular.z for message in heard["twist"]] == [-t for t in times]
    assert [list(m.points[0].positions) for m in heard["trajectory"]] == [[t, 2 * t] for t in times]
    assert {m.points[0].time_from_start.nanosec for m in heard["trajectory"]} == {20_000_000}
    assert [list(message.data) for message in heard["array"]] == [[0.0, 0.0, t] for t in times]
    assert [m.data for m in heard["byte"]] == [round(10.4 + min(100 * t, 200)) for t in times]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in heard["twist"]]
    assert stamps == sorted(stamps)
    assert stamps[0] > 0


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"topic": "nobody"}, "publish.topic: nothing subscribes to /nobody"),
        ({"profile": {"date": "t"}}, "publish.profile.date: std_msgs/msg/Float64 has no field"),
        ({"profile": {"data[0]": "t"}}, "publish.profile.data[0]: data is no array; leave out [0]"),
        (
            {"topic": "trajectory", "profile": {"joint_names[0]": "t"}},
            "publish.profile.joint_names[0]: joint_names is text; expected a number",
        ),
        (
            {"topic": "array", "profile": {"data[1000]": "t"}},
            "publish.profile.data[1000]: data has at most 1000 items; none for [1000]",
        ),
        (
            {"topic": "byte", "profile": {"data": "300 * t"}},
            "publish.profile: data is 258 at 0.86 s; expected an integer from 0 to 255",
        ),
        ({"profile": {"data": "1 / (1 - t)"}}, "publish.profile: data is inf at 1 s; expected a"),
    ],
)  # fmt: skip
def test_a_reference_that_cannot_stream(refusal, listener, change, complaint):
    step = {"publish": HELD | {"topic": "left", "profile": {"data": "t"}} | change}
    assert refusal(run={"start": [step], "end": {"after": 2.0}}).startswith(
        f"run.start[0].{complaint}"
    )


def test_of_several_topics_the_one_that_is_wrong_is_named(refusal, listener):
    topics = [{"topic": "left"}, {"topic": "nobody"}]
    reason = refusal(run={"start": [{"publish": HELD | {"topics": topics}}]})
    assert reason.startswith("run.start[0].publish.topics[1].topic: nothing subscribes to /nobody")


def disturbance(outcome):
    reason = failure(outcome)
    assert outcome.notes.unusable is Unusable.DISTURBED
    return reason


def test_a_rate_that_is_not_held_is_a_fault_of_the_run(backend, listener, monkeypatch):
    made = backend(run={"start": [stream("left", "t", largest_gap=0.1)], "end": {"after": 5.0}})
    publish = OwnTopic.publish

    def late(topic, message):
        time.sleep(0.3)
        publish(topic, message)

    monkeypatch.setattr(OwnTopic, "publish", late)
    reason = disturbance(run(made))
    assert reason.startswith("the stream on /left does not keep its rate of 50 Hz: no message for")
    assert reason.endswith("s, expected one at least every 0.1 s")


def test_a_rate_of_which_too_much_is_left_out(backend, listener, monkeypatch):
    monkeypatch.setattr(streams, "MOST_LEFT_OUT", 0.2)
    made = backend(run={"start": [stream("left", "t")], "end": {"after": 5.0}})
    publish = OwnTopic.publish

    def late(topic, message):
        time.sleep(0.05)
        publish(topic, message)

    monkeypatch.setattr(OwnTopic, "publish", late)
    reason = disturbance(run(made))
    assert "does not keep its rate of 50 Hz" in reason
    assert reason.endswith("messages are left out, as they would be late")


def test_a_tuner_that_does_not_look_drives_nothing_on(backend, listener, monkeypatch):
    made = backend(run={"start": [stream("left", "t")], "end": {"after": 5.0}})
    monkeypatch.setattr(streams, "UNSERVED", -1.0)
    reason = disturbance(run(made))
    assert reason.startswith("the stream on /left: ended, as the run was not looked at for")
    assert listener.numbers("left") == [0.0]


def test_a_reference_that_nobody_hears_any_more(backend, listener, leave, in_run):
    made = backend(run={"start": [stream("left", "t")], "end": {"after": 5.0}})
    in_run(made, lambda: [listener.destroy_subscription(s) for s in list(listener.subscriptions)])
    assert failure(run(made)) == "nothing subscribes to /left"


def test_a_node_that_does_not_follow(backend, listener):
    """The servo follows /setpoint, and knows nothing of /left."""
    step = {"step": {"final": 1.0, "after": 0.05}}
    wait = [{"wait": 0.3}]
    follow = {"follow": {"data": "angle"}}
    made = backend(run={"start": [stream("left", step, **follow), *wait]})
    assert failure(run(made)) == (
        "signal angle does not follow the stream on /left: it moves by 0, while data moves by 1"
    )
    made.close()
    moved = {"condition": "angle > 0.5", "hold": 0, "timeout": 60.0}
    start = [stream("setpoint", step, **follow), {"wait_until": moved}]
    complete(run(backend(run={"start": start, "timeout": DEADLINE})))


def test_somebody_else_on_the_topic_of_a_stream(backend, listener, join, in_run):
    made = backend(run={"start": [stream("left", "t")], "end": {"after": 1.5}})
    complete(run(made))
    other = Node("intruder", context=listener.context)
    try:
        publisher = other.create_publisher(Float64, "left", 10)
        own = made._procedure._recorder.node
        wait_until(lambda: own.count_publishers("left") > 1, "the other publisher")
        listening = own.count_subscribers("left")
        wait_until(lambda: publisher.get_subscription_count() >= listening, "its listeners")
        in_run(made, lambda: publisher.publish(Float64(data=0.0)))
        assert disturbance(run(made)).startswith("/intruder published on /left in the run, too")
    finally:
        other.destroy_node()


RAMP_DOWN = {"ramp": {"initial": 1.0, "final": 0.25, "duration": 0.2}}


@pytest.mark.parametrize("abort", ["", "t > 0.1"])
def test_a_reference_may_bring_the_machine_to_rest(backend, listener, abort):
    """The steps after it wait for its end, whether the run was completed or not."""
    made = backend(
        run={
            "start": [stream("left", "1 + 0 * t")],
            "after": [
                stream("left", RAMP_DOWN, duration=0.2),
                {"publish": {"topic": "left", "message": {"data": 0.0}}},
            ],
            "abort_when": abort,
        }
    )
    outcome = run(made)
    assert outcome.complete == (abort == "")
    heard = listener.numbers("left")
    ramp = heard[heard.index(1.0) :]
    assert heard[-2:] == [0.25, 0.0]
    assert len(set(ramp)) > 3
    assert sorted(ramp, reverse=True) == ramp


def test_a_reference_on_the_way_home_ends_with_it(backend, system, listener):
    """A watchdog is fed while the machine is waited for."""
    made = backend(
        run={
            "abort_when": "t > 0.1",
            "recover": [stream("left", "5 + t"), {"wait": 0.3}],
        }
    )
    assert "aborted" in failure(run(made))
    # The last message may still be on its way.
    time.sleep(0.2)
    heard = listener.numbers("left")
    assert heard[0] == 5.0
    assert heard[-1] > 5.1
    time.sleep(0.2)
    assert listener.numbers("left") == heard


def test_a_guard_has_the_last_message_of_a_stream():
    after = [
        {"publish": HELD | {"topic": "left", "profile": {"data": RAMP_DOWN}, "duration": 0.2}},
        {"publish": {"topic": "right", "message": {"data": 2.0}}},
        {"wait": 1.0},
        {"publish": {"topic": "twist"}},
    ]
    left, right = Plan.of(servo_study(run={"after": after})).stop
    assert (left.topic, right.topic) == ("left", "right")
    (profile,) = left.profile.values()
    assert profile.function("")(np.zeros(1)) == pytest.approx([0.25])


class Simulation(Node):
    """Publishes a time that goes on by `step` [ns] every 5 ms of the machine."""

    def __init__(self, step, context):
        super().__init__("simulation", context=context)
        self.step = step
        self.now = 100_000_000_000
        self._publisher = self.create_publisher(Clock, "/clock", 10)
        self.create_timer(0.005, self._tick)

    def _tick(self):
        self.now += self.step
        self._publisher.publish(Clock(clock=to_stamp(self.now)))


def test_in_simulated_time(backend, listener, join):
    """The simulation is ten times slower than the machine, and so is the reference."""
    join(Simulation, 500_000)
    topics = [
        {"topic": "twist", "profile": {"twist.linear.x": "t"}},
        {"topic": "left", "profile": {"data": "t"}},
    ]
    made = backend(
        signals={"angle": ANGLE},
        run={
            "clock": "sim",
            "start": [{"publish": HELD | {"topics": topics}}],
            "end": {"after": 0.2},
        },
    )
    complete(run(made))
    heard = listener.heard["twist"]
    assert 2 < len(heard) <= 11
    times = [message.twist.linear.x for message in heard]
    assert listener.numbers("left") == times
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in heard]
    # A message is due at its time, and comes with the next one of the clock at the earliest.
    assert all(late > -1e-6 for late in np.array(stamps) - stamps[0] - times)
    assert stamps[0] > 100.0


def test_a_simulation_whose_time_goes_on_by_more_than_a_period(
    backend, listener, join, monkeypatch
):
    monkeypatch.setattr(streams, "MOST_LEFT_OUT", 0.2)
    join(Simulation, 100_000_000)
    made = backend(
        signals={"angle": ANGLE},
        run={"clock": "sim", "start": [stream("left", "t")], "end": {"after": 8.0}},
    )
    reason = disturbance(run(made))
    assert "the stream on /left does not keep its rate of 50 Hz" in reason
    assert "/clock goes on by about" in reason


@pytest.fixture
def pulse(join):
    return join(Sensor)


SENSED = {"sensed": {"topic": "/sensed", "field": "data"}}


def test_a_run_joins_a_reference_at_its_edge(backend, pulse, in_run):
    """That it is high when it is first looked at is no edge."""
    pulse.value = 1.0
    rising = {"condition": "sensed > 0.5", "hold": 0, "rising": True, "timeout": DEADLINE}
    made = backend(signals=SENSED, run={"start": [{"wait_until": rising}, {"wait": 0.1}]})
    steps = []

    def turn():
        for value in (0.0, 1.0):
            time.sleep(0.2)
            steps.append(value)
            pulse.value = value

    in_run(made, turn)
    complete(run(made))
    assert steps == [0.0, 1.0]
    sensed = made.recording.signals["sensed"].value
    assert sensed[0] == 1.0
    assert 0.0 in sensed
    assert sensed[-1] == 1.0


def test_a_condition_that_does_not_come_to_hold(backend, pulse):
    pulse.value = 1.0
    rising = {"condition": "sensed > 0.5", "hold": 0, "rising": True, "timeout": 0.3}
    made = backend(signals=SENSED, run={"before": [{"wait_until": rising}]})
    assert failure(run(made)).startswith(
        "run.before[2]: 'sensed > 0.5' does not come to hold, as it never ceased to within 0.3 s "
        "(sensed 1)"
    )
