"""The Kalman filter of the feed axis as a node, which reads its variances only while it starts.

It hears what the controller hears and commands, and answers each measurement on /estimate, and on
/innovation with the innovation [m/s] and its variance.
"""

from functools import partial

import rclpy
from axis import COMMAND, MEASURED, REFERENCE, Filter
from nodes import spin
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

DEPTH = 100
"""Messages that may wait."""


class AxisNode(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("axis_filter")
        names = {"lambda_kf": -1.0, "measurement_variance": 0.01}
        self.filter = Filter(*(self.declare_parameter(*item).value for item in names.items()))
        self.estimate = self.create_publisher(JointState, "/estimate", DEPTH)
        self.innovation = self.create_publisher(Float64MultiArray, "/innovation", DEPTH)
        self.subscriptions_ = [
            self.create_subscription(kind, topic, partial(self.take, topic), DEPTH)
            for topic, kind in (
                (REFERENCE, JointTrajectory),
                (MEASURED, JointState),
                (COMMAND, JointState),
            )
        ]

    def take(self, topic: str, message: JointState | JointTrajectory) -> None:
        """Take a message, and publish what a measurement has shown."""
        of_reference = isinstance(message, JointTrajectory)
        values = message.points[0].velocities if of_reference else message.velocity
        stamp = message.header.stamp
        time = stamp.sec * 1_000_000_000 + stamp.nanosec
        if found := self.filter.take(topic, time, values[0]):
            self.estimate.publish(JointState(header=message.header, velocity=found[:1]))
            self.innovation.publish(Float64MultiArray(data=found[1:]))


if __name__ == "__main__":
    rclpy.init()
    spin(AxisNode())
