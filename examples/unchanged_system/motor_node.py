"""A motor with a flexible load as a ROS 2 node; it knows nothing of any tuner.

Takes the torque on /torque [N m], publishes angle [rad] and speed [rad/s] of the motor on
/joint_states at 100 Hz, and returns to rest by the service /motor/reset.
"""

import math
import signal

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Empty

PERIOD, STEPS = 0.01, 20
INERTIA, FRICTION, MAX_TORQUE = 0.02, 0.05, 1.0  # [kg m²], [N m s/rad], [N m]
LAG = 0.02  # of the drive, from the torque that is wanted to the torque that acts [s]


class Motor(Node):
    """Moves by itself, step by step, whoever looks on."""

    def __init__(self) -> None:
        super().__init__("motor")
        self._reset()
        self._states = self.create_publisher(JointState, "joint_states", 10)
        self.create_subscription(Float64, "torque", self._on_torque, 10)
        self.create_service(Empty, "~/reset", self._on_reset)
        self.create_timer(PERIOD, self._step)

    def _reset(self) -> None:
        self._wanted = self._torque = self._speed = self._angle = 0.0

    def _on_reset(self, _request: Empty.Request, response: Empty.Response) -> Empty.Response:
        self._reset()
        return response

    def _on_torque(self, message: Float64) -> None:
        if math.isfinite(message.data):
            self._wanted = min(max(message.data, -MAX_TORQUE), MAX_TORQUE)

    def _step(self) -> None:
        h = PERIOD / STEPS
        for _ in range(STEPS):
            self._torque += h / LAG * (self._wanted - self._torque)
            self._speed += h / INERTIA * (self._torque - FRICTION * self._speed)
            self._angle += h * self._speed
        message = JointState(name=["motor"], position=[self._angle], velocity=[self._speed])
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Motor()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
