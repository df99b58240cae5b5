"""The filter of the robot as a node, which reads its noise only while it starts.

It hears /wheel/odom, /imu and /fix, and publishes /estimate with its covariance at each message of
/imu.
"""

import math

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from nodes import seconds_since, spin
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from robot import Filter
from sensor_msgs.msg import Imu


class EkfNode(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("ekf")
        names = {"speed_noise": 0.5, "bias_walk": 0.03, "fix_noise": 1.0}
        noise = [self.declare_parameter(name, value).value for name, value in names.items()]
        self.filter = Filter(*noise)
        self.began: int | None = None
        self.subscriptions_ = [
            self.create_subscription(kind, topic, callback, qos_profile_sensor_data)
            for kind, topic, callback in (
                (Odometry, "/wheel/odom", self.take_speed),
                (PoseWithCovarianceStamped, "/fix", self.take_fix),
                (Imu, "/imu", self.take_rate),
            )
        ]
        self.publisher = self.create_publisher(Odometry, "/estimate", qos_profile_sensor_data)

    def take_speed(self, message: Odometry) -> None:
        """Take the speed of the wheels."""
        self.filter.speed = message.twist.twist.linear.x

    def take_fix(self, message: PoseWithCovarianceStamped) -> None:
        """Correct by a position."""
        position = message.pose.pose.position
        self.filter.correct(position.x, position.y)

    def take_rate(self, message: Imu) -> None:
        """Go on by a yaw rate, and publish."""
        self.began, time = seconds_since(self.began, message.header.stamp)
        self.filter.predict(time, message.angular_velocity.z)
        x, y, yaw, _ = self.filter.state
        estimate = Odometry(header=message.header, child_frame_id="base_link")
        estimate.header.frame_id = "odom"
        pose = estimate.pose
        pose.pose.position.x, pose.pose.position.y = float(x), float(y)
        pose.pose.orientation.z, pose.pose.orientation.w = half_turn(float(yaw))
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            pose.covariance[6 * row + column] = float(self.filter.covariance[row, column])
        self.publisher.publish(estimate)


def half_turn(yaw: float) -> tuple[float, float]:
    """Return z and w of the quaternion of a heading."""
    return math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def main() -> None:
    """Run the node."""
    rclpy.init()
    spin(EkfNode())


if __name__ == "__main__":
    main()
