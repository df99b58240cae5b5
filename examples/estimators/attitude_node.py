"""The filter of the attitude as a node, which reads its gains only while it starts.

It hears /imu, and answers each message on /attitude.
"""

import rclpy
from attitude import Filter
from nodes import seconds_since, spin
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu


class AttitudeNode(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("attitude")
        names = {"gain": 5.0, "bias_gain": 0.1, "trust": 5.0}
        gains = [self.declare_parameter(name, value).value for name, value in names.items()]
        self.filter = Filter(*gains)
        self.began: int | None = None
        self.publisher = self.create_publisher(Imu, "/attitude", qos_profile_sensor_data)
        self.subscription_ = self.create_subscription(
            Imu, "/imu", self.take, qos_profile_sensor_data
        )

    def take(self, message: Imu) -> None:
        """Take a measurement, and publish."""
        self.began, time = seconds_since(self.began, message.header.stamp)
        rate, felt = message.angular_velocity, message.linear_acceleration
        w, x, y, z = self.filter.take(time, (rate.x, rate.y, rate.z), (felt.x, felt.y, felt.z))
        turned = message.orientation
        turned.w, turned.x, turned.y, turned.z = w, x, y, z
        self.publisher.publish(message)


if __name__ == "__main__":
    rclpy.init()
    spin(AttitudeNode())
