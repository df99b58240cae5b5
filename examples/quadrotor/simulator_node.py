"""A Crazyflie in wind as a ROS 2 node: RotorPy's dynamics in simulated time, in lock step.

Publishes the measured state on /odom (the velocity in the world frame, the rates in that of the
body) and the time on /clock, every 10 ms of simulated time. It goes on when the command for that
state has come on /motor_speeds: rotor speeds [rad/s] in a JointState with the stamp of the state.
So a flight takes as long as the two nodes need to compute it, and is the same on any computer.

Wind, payload, motors and the seed of gusts and measurement noise are parameters; they hold from the
next reset on. The simulation starts paused, and ~/reset puts the vehicle back to hover, paused.
"""

import signal

import numpy as np
import rclpy
from flight import Conditions, Flight
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

RESEND_PERIOD = 0.2  # of a state that nobody answers [s]
PARAMETERS = {
    "wind_speed": "mean wind [m/s]",
    "wind_direction": "direction to which the wind blows, from x to y [rad]",
    "gust": "standard deviation of the gusts [m/s]",
    "payload": "mass that is carried [kg]",
    "motor_time_constant": "of the rotor speeds [s]",
    "seed": "of gusts and measurement noise",
}


class Simulator(Node):
    """Flies step by step, each when it is told the rotor speeds."""

    def __init__(self) -> None:
        super().__init__("crazyflie")
        defaults = Conditions()
        for name, text in PARAMETERS.items():
            self.declare_parameter(
                name, getattr(defaults, name), ParameterDescriptor(description=text)
            )
        self._paused = self._answered = True
        self._odometry = self.create_publisher(Odometry, "odom", 10)
        self._simulated_time = self.create_publisher(Clock, "/clock", 10)
        self.create_subscription(JointState, "motor_speeds", self._on_motor_speeds, 10)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_timer(RESEND_PERIOD, self._resend)
        self._reset()

    def _reset(self) -> None:
        self._paused = True
        self._flight = Flight(
            Conditions(**{name: self.get_parameter(name).value for name in PARAMETERS})
        )
        self._state = self._message()
        self._publish()

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._reset()
            response.success = True
        except (ValueError, ArithmeticError) as error:
            response.message = str(error)
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        if not self._paused:
            self._publish()
        response.success = True
        return response

    def _on_motor_speeds(self, message: JointState) -> None:
        if self._paused or message.header.stamp != self._state.header.stamp:
            return
        self._answered = True
        self._flight.step(np.array(message.velocity))
        self._state = self._message()
        self._publish()

    def _resend(self) -> None:
        """Say again what was not answered since the last time; while paused, the time alone."""
        if self._paused:
            self._simulated_time.publish(Clock(clock=self._state.header.stamp))
        elif not self._answered:
            self._publish()
        self._answered = False

    def _publish(self) -> None:
        self._simulated_time.publish(Clock(clock=self._state.header.stamp))
        self._odometry.publish(self._state)

    def _message(self) -> Odometry:
        seen = self._flight.measure()
        message = Odometry(child_frame_id="crazyflie")
        message.header.frame_id = "world"
        message.header.stamp = Time(nanoseconds=round(self._flight.time * 1e9)).to_msg()
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y, pose.position.z = seen["x"].tolist()
        orientation = pose.orientation
        orientation.x, orientation.y, orientation.z, orientation.w = seen["q"].tolist()
        twist.linear.x, twist.linear.y, twist.linear.z = seen["v"].tolist()
        twist.angular.x, twist.angular.y, twist.angular.z = seen["w"].tolist()
        return message


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Simulator()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
