"""A turtle that takes a while to reach its speeds, as a node `turtle` with topics of turtlesim.

Hears /turtle1/cmd_vel, publishes /turtle1/pose at 100 Hz; the service /turtle/reset takes it home.
"""

import contextlib
import math

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import Trigger
from turtlesim.msg import Pose

PERIOD = 0.01


class Turtle(Node):
    """The turtle."""

    def __init__(self):
        super().__init__("turtle")
        self.declare_parameter("tau", 0.1)
        self.reset()
        self.poses = self.create_publisher(Pose, "/turtle1/pose", 10)
        self.create_subscription(Twist, "/turtle1/cmd_vel", self.hear, 10)
        self.create_service(Trigger, "~/reset", lambda request, answer: self.reset(answer))
        self.create_timer(PERIOD, self.step)

    def reset(self, answer=None):
        """Go home, and stop."""
        self.command, self.pose = Twist(), Pose()
        if answer is not None:
            answer.success = True
        return answer

    def hear(self, message):
        """Take a command."""
        self.command = message

    def step(self):
        """Move for a period, and publish."""
        pose, share = self.pose, PERIOD / self.get_parameter("tau").value
        pose.linear_velocity += share * (self.command.linear.x - pose.linear_velocity)
        pose.angular_velocity += share * (self.command.angular.z - pose.angular_velocity)
        pose.theta += PERIOD * pose.angular_velocity
        pose.x += PERIOD * pose.linear_velocity * math.cos(pose.theta)
        pose.y += PERIOD * pose.linear_velocity * math.sin(pose.theta)
        self.poses.publish(pose)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Turtle())
