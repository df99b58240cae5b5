"""A system that knows nothing of the tuner: a servo at 100 Hz, and a study of it."""

import contextlib
import math
import time

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from signal_runs import signal_study
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from bo_tuner.backends.ros.clock import to_stamp
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage

BEST_EFFORT = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)

SAFE, UNSTABLE = 0.25, 2.5
"""Gains: with the second the angle grows without bounds, |1 - 2.5| > 1."""
ROOM = {
    "abort_when": "abs(angle) > 3",
    "end": {"when": "abs(angle - 1) < 0.05"},
    "timeout": 60.0,
}
"""A run ends where a stable step response comes to, and has the time that a busy machine takes."""


class Sensor(Node):
    """Publishes `value` on /sensed at 100 Hz; it has no parameters that anybody sets."""

    def __init__(self, context, name="sensor", topic="sensed"):
        super().__init__(name, context=context)
        self.value = 0.0
        publisher = self.create_publisher(Float64, topic, 10)
        self.create_timer(0.01, lambda: publisher.publish(Float64(data=self.value)))


class Simulation(Node):
    """Publishes the time, `speed` times as fast as it passes."""

    def __init__(self, context):
        super().__init__("simulation", context=context)
        self.speed = 5
        self.now = 100_000_000_000
        self.stops_at = None
        self._publisher = self.create_publisher(Clock, "/clock", 10)
        self.create_service(Trigger, "simulation/reset", self._reset)
        self.create_timer(0.002, self._tick)

    def _reset(self, request, response):
        self.now = 0
        response.success = True
        return response

    def _tick(self):
        if self.stops_at is None or self.now < self.stops_at:
            self.now += int(2_000_000 * self.speed)
        self._publisher.publish(Clock(clock=to_stamp(self.now)))


class System(Node):
    """Follows /setpoint by `gain` at 100 Hz, from its start on."""

    def __init__(self, context, **options):
        super().__init__("servo", context=context, **options)
        self.declare_parameter("gain", 0.5)
        self.declare_parameter("serial", 7.0, ParameterDescriptor(read_only=True))
        self.declare_parameter("count", 3)
        limits = FloatingPointRange(from_value=0.0, to_value=2.0)
        limited = ParameterDescriptor(floating_point_range=[limits])
        self.declare_parameter("limited", 1.0, limited)
        self.received = []
        self.asked_to_set = 0
        self.asked_gains = []
        self.add_on_set_parameters_callback(self.judge)
        self.begin()
        self.states = self.create_publisher(JointState, "joint_states", BEST_EFFORT)
        self.plain = self.create_publisher(Float64MultiArray, "plain", 10)
        self.text = self.create_publisher(String, "text", 10)
        self.limit = self.create_publisher(Float64, "limit", LATCHED)
        self.limit.publish(Float64(data=2.5))
        self.fault = self.create_publisher(Float64, "fault", 10)
        self.create_subscription(Float64, "setpoint", self.follow, 10)
        self.create_subscription(JointState, "wanted", self.received.append, 10)
        self.create_service(Trigger, "~/reset", self.reset)
        self.create_service(SetBool, "~/enable", self.enable)
        self.create_timer(0.01, self.step)

    def begin(self):
        """Be as at first."""
        self.angle = self.setpoint = 0.0
        self.names = ["other", "motor"]
        self.silent = False
        self.ahead = 0.0
        self.hang = 0.0
        self.refusal = ""
        self.refuses_beyond = math.inf
        self.accepts = lambda: True
        self.gains_at_reset = []
        self.received.clear()
        self.set_gain(0.5)
        self.asked_gains.clear()

    def set_gain(self, value):
        self.set_parameters([Parameter("gain", value=value)])

    @contextlib.contextmanager
    def refusing(self, reason):
        """Refuse parameters meanwhile."""
        self.refusal = reason
        yield
        self.refusal = ""

    def judge(self, parameters):
        self.asked_to_set += 1
        # As of an author who expects something in it: nobody else sets nothing.
        self.last_asked = parameters[0].name
        self.asked_gains += [item.value for item in parameters if item.name == "gain"]
        reason = "the key is out" if abs(self.angle) > self.refuses_beyond else self.refusal
        reason = reason if self.accepts() else "it is at work"
        return SetParametersResult(successful=not reason, reason=reason)

    def follow(self, message):
        self.setpoint = message.data
        hang, self.hang = self.hang, 0.0
        time.sleep(hang)

    def reset(self, request, response):
        self.gains_at_reset.append(self.get_parameter("gain").value)
        self.angle = self.setpoint = 0.0
        response.success = True
        return response

    def enable(self, request, response):
        response.success = request.data
        response.message = "the brake is on"
        return response

    def step(self):
        self.angle += self.get_parameter("gain").value * (self.setpoint - self.angle)
        if self.silent:
            return
        message = JointState(name=self.names, position=[7.0, self.angle])
        message.header.stamp = (self.get_clock().now() + Duration(seconds=self.ahead)).to_msg()
        self.states.publish(message)
        self.plain.publish(Float64MultiArray(data=[1.0, self.angle]))


def study(signals=None, run=None, metrics=None, **others):
    """A study of the system, with changes within sections, and `others` in place of whole ones."""
    mapping = signal_study(
        run={
            "before": [{"call": {"service": "servo/reset"}}],
            "start": [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}],
            # Not after a time: on a busy machine the step of `start` may come only then.
            "end": {"when": "t > 0.3"},
        }
    )
    for section, changes in (("signals", signals), ("run", run), ("metrics", metrics)):
        mapping[section] |= changes or {}
    return study_from_mapping(mapping | others)


def run(backend, gain=0.5):
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": gain}, {}, 1))


def gain(system):
    return system.get_parameter("gain").value


def failure(outcome):
    assert outcome.state is EvaluationState.FAILED, outcome
    assert outcome.metrics == {}
    return outcome.reason
