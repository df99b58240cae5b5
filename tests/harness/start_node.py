"""A servo that takes its gain only while it starts, as most nodes of rclpy do; run as a program.

It follows /setpoint at 100 Hz, publishes /angle, and tells on /used the gain that it goes by. The
parameter accepts other values at any time, and does nothing then. Words ahead of --ros-args:

``lifecycle``
    takes the gain when it is configured, and moves while it is active;
``active``
    configures and activates itself, as a launch file would do with it;
``reload``
    takes it when its service ~/reload is called, which says no to one above 2 if it is limited;
``ignores``
    has another way to its settings, and does not look at its arguments;
``limited``
    does not start with a gain above 2;
``hangs``
    does not come up with such a gain, and does not end either;
``clamps``
    takes 1.5 for a gain above that;
``gain=1.5``
    has this gain, and no such parameter;
``clock``
    is a simulation, whose time on /clock begins at 0;
``second``
    is called `second` and publishes /second/angle and /second/used.
"""

import signal
import sys
import threading

import rclpy
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

DEFAULT, LIMIT, CLAMP = 0.5, 2.0, 1.5


class Servo:
    """Moves for a node, by the gain that it is given."""

    def __init__(self, node, gain):
        self.gain, self.angle, self.setpoint = gain, 0.0, 0.0
        self.angles = node.create_publisher(Float64, f"{node.prefix}angle", 10)
        self.used = node.create_publisher(Float64, f"{node.prefix}used", 10)
        self.subscription = node.create_subscription(Float64, "setpoint", self.follow, 10)
        self.timer = node.create_timer(0.01, self.step)

    def follow(self, message):
        self.setpoint = message.data

    def step(self):
        self.angle += 0.1 * self.gain * (self.setpoint - self.angle)
        self.angles.publish(Float64(data=self.angle))
        self.used.publish(Float64(data=self.gain))


class Plain(Node):
    """Reads the gain in its constructor."""

    def __init__(self, words):
        name = "second" if "second" in words else "servo"
        super().__init__(name)
        self.prefix = "second/" if "second" in words else ""
        self.declare_parameter("mass", 1.0)
        given = [float(word[5:]) for word in words if word.startswith("gain=")]
        if not given:
            self.declare_parameter("gain", DEFAULT)
        gain = given[0] if given else self.get_parameter("gain").value
        if "limited" in words and gain > LIMIT:
            raise SystemExit(f"a gain of {gain} is too high")
        if "hangs" in words and gain > LIMIT:
            threading.Event().wait(60.0)
        if "clamps" in words and gain > CLAMP:
            gain = CLAMP
            self.set_parameters([Parameter("gain", value=gain)])
        self.servo = Servo(self, gain)
        self.limited = "limited" in words
        if "reload" in words:
            self.create_service(Trigger, "~/reload", self.reload)
        if "clock" in words:
            self.time = 0
            self.clock = self.create_publisher(Clock, "/clock", 10)
            self.create_timer(0.01, self.tick)

    def reload(self, request, answer):
        gain = self.get_parameter("gain").value
        answer.success = not (self.limited and gain > LIMIT)
        answer.message = "" if answer.success else f"a gain of {gain} is too high"
        self.servo.gain = gain if answer.success else self.servo.gain
        return answer

    def tick(self):
        self.time += 10_000_000
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.time, 1_000_000_000)
        self.clock.publish(message)


class Configured(LifecycleNode):
    """Reads the gain in `on_configure`."""

    prefix = ""

    def __init__(self, words):
        super().__init__("servo")
        self.limited = "limited" in words
        self.declare_parameter("gain", DEFAULT)
        self.declare_parameter("mass", 1.0)
        self.gain, self.servo = 0.0, None

    def on_configure(self, state):
        self.gain = self.get_parameter("gain").value
        refused = self.limited and self.gain > LIMIT
        return TransitionCallbackReturn.FAILURE if refused else TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        self.servo = Servo(self, self.gain)
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state):
        self.destroy_timer(self.servo.timer)
        self.destroy_subscription(self.servo.subscription)
        self.destroy_publisher(self.servo.angles)
        self.destroy_publisher(self.servo.used)
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state):
        return TransitionCallbackReturn.SUCCESS


def main():
    words = set(sys.argv[1 : (*sys.argv, "--ros-args").index("--ros-args")])
    signals = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, frame: signals.append(signum))
    arguments = [] if "ignores" in words else sys.argv
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = (Configured if "lifecycle" in words else Plain)(words)
    if "active" in words:
        node.trigger_configure()
        node.trigger_activate()
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
