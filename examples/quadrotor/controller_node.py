"""RotorPy's geometric controller as a ROS 2 node.

Takes where to be on /goal_pose and the state on /odom, and answers each state with the speeds of
the four rotors [rad/s] on /motor_speeds, with the stamp of the state. The gains are parameters;
their defaults are those of RotorPy. The controller knows the vehicle without its payload.
"""

import math
import signal

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles import crazyflie_params
from sensor_msgs.msg import JointState

ROTORS = ["r1", "r2", "r3", "r4"]
GAINS = {
    "kp_xy": "of the position, horizontally [1/s²]",
    "kd_xy": "of the velocity, horizontally [1/s]",
    "kp_z": "of the height [1/s²]",
    "kd_z": "of the vertical velocity [1/s]",
    "kp_att": "of the attitude [1/s²]",
    "kd_att": "of the body rates [1/s]",
}


class GeometricController(Node):
    """Answers each state with a command."""

    def __init__(self) -> None:
        super().__init__("geometric_controller")
        self._control = SE3Control(crazyflie_params.quad_params)
        gains = self._gains()
        # Before the declarations, so that it judges the values of a parameter file, too.
        self.add_on_set_parameters_callback(self._judge)
        for name, text in GAINS.items():
            self.declare_parameter(name, gains[name], ParameterDescriptor(description=text))
        self.add_post_set_parameters_callback(self._apply)
        self._apply([self.get_parameter(name) for name in GAINS])
        self._goal = np.array([0.0, 0.0, 1.0])
        self._motor_speeds = self.create_publisher(JointState, "motor_speeds", 10)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)
        self.create_subscription(Odometry, "odom", self._on_state, 10)

    def _gains(self) -> dict[str, float]:
        """Return the gains that the controller has."""
        (kp_xy, _, kp_z), (kd_xy, _, kd_z) = self._control.kp_pos, self._control.kd_pos
        values = (kp_xy, kd_xy, kp_z, kd_z, self._control.kp_att, self._control.kd_att)
        return dict(zip(GAINS, map(float, values), strict=True))

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        for item in parameters:
            if item.name in GAINS and not (math.isfinite(item.value) and item.value >= 0.0):
                reason = f"{item.name}: expected a number of at least 0, found {item.value:g}"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        changed = {item.name: item.value for item in parameters if item.name in GAINS}
        gains = self._gains() | changed
        self._control.kp_pos = np.array([gains["kp_xy"], gains["kp_xy"], gains["kp_z"]])
        self._control.kd_pos = np.array([gains["kd_xy"], gains["kd_xy"], gains["kd_z"]])
        self._control.kp_att, self._control.kd_att = gains["kp_att"], gains["kd_att"]

    def _on_goal(self, message: PoseStamped) -> None:
        position = message.pose.position
        self._goal = np.array([position.x, position.y, position.z])

    def _on_state(self, message: Odometry) -> None:
        pose, twist = message.pose.pose, message.twist.twist
        q, rates = pose.orientation, twist.angular
        state = {
            "x": np.array([pose.position.x, pose.position.y, pose.position.z]),
            "v": np.array([twist.linear.x, twist.linear.y, twist.linear.z]),
            "q": np.array([q.x, q.y, q.z, q.w]),
            "w": np.array([rates.x, rates.y, rates.z]),
        }
        wanted = {"x": self._goal, "yaw": 0.0, "yaw_dot": 0.0}
        wanted |= {key: np.zeros(3) for key in ("x_dot", "x_ddot", "x_dddot", "x_ddddot")}
        command = self._control.update(0.0, state, wanted)
        answer = JointState(name=ROTORS, velocity=command["cmd_motor_speeds"].tolist())
        answer.header.stamp = message.header.stamp
        self._motor_speeds.publish(answer)


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = GeometricController()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
