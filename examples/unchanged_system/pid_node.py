"""A position controller as a ROS 2 node, free-running at 100 Hz; it knows nothing of any tuner.

Its gains kp, ki and kd are parameters. It takes the wanted angle on /setpoint [rad] and the angle
and speed of the motor on /joint_states, and publishes the torque on /torque [N m].
"""

import signal

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

PERIOD, MAX_TORQUE = 0.01, 1.0


class Pid(Node):
    """Controls the motor from its start on."""

    def __init__(self) -> None:
        super().__init__("pid")
        for name, value in (("kp", 0.5), ("ki", 0.0), ("kd", 0.02)):
            self.declare_parameter(name, value)
        self._setpoint = self._integral = 0.0
        self._state: tuple[float, float] | None = None
        self._torque = self.create_publisher(Float64, "torque", 10)
        self.create_subscription(Float64, "setpoint", self._on_setpoint, 10)
        self.create_subscription(JointState, "joint_states", self._on_state, 10)
        self.create_timer(PERIOD, self._step)

    def _on_setpoint(self, message: Float64) -> None:
        if message.data != self._setpoint:
            self._setpoint, self._integral = message.data, 0.0

    def _on_state(self, message: JointState) -> None:
        index = message.name.index("motor")
        self._state = (message.position[index], message.velocity[index])

    def _step(self) -> None:
        if self._state is None:
            return
        kp, ki, kd = (self.get_parameter(name).value for name in ("kp", "ki", "kd"))
        angle, speed = self._state
        error = self._setpoint - angle
        torque = kp * error + self._integral - kd * speed
        if abs(torque) < MAX_TORQUE:  # no integration while the torque is at its limit
            self._integral += ki * PERIOD * error
        self._torque.publish(Float64(data=min(max(torque, -MAX_TORQUE), MAX_TORQUE)))


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Pid()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
