"""Small plants beside public controllers: ``python3 plants.py KIND``, node `plant`, at 100 Hz.

Each moves by ``gain`` and ``tau`` (parameters, contexts of the studies), and goes back to rest by
the service ``/plant/reset``. Kinds, with what they hear and publish:

``angle``
    a geared motor: /voltage, /measured_angle (Float64)
``process``
    the same with Float32: /control_value_topic, /actual_state_topic
``speed``
    a motor's speed: /motor_input_u, /motor_speed_y (Float32)
``joint``
    a servo that follows a position: /position_control/commands, /joint_states
``vehicle``
    a car's speed: /accel (AccelStamped), /vehicle_velocity (TwistStamped)
``robot``
    a robot on two wheels: /cmd_vel (Twist), /odom (Odometry)
``localized``
    the same: /bcr_bot/cmd_vel (Twist), /amcl_lite_pose (PoseStamped)
"""

import contextlib
import math
import sys

import rclpy
from geometry_msgs.msg import AccelStamped, PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32, Float64, Float64MultiArray
from std_srvs.srv import Trigger

PERIOD = 0.01


class Plant(Node):
    """A plant, by its kind."""

    def __init__(self, kind):
        super().__init__("plant")
        hears, topic, publishes, out = KINDS[kind]
        self.kind = kind
        self.declare_parameter("gain", 1.0)
        self.declare_parameter("tau", 0.2)
        self.reset()
        self.publisher = self.create_publisher(publishes, out, 10)
        self.create_subscription(hears, topic, self.hear, 10)
        self.create_service(Trigger, "~/reset", lambda request, answer: self.reset(answer))
        self.create_timer(PERIOD, self.step)

    def reset(self, answer=None):
        """Go to rest."""
        self.input, self.turn = 0.0, 0.0
        self.x = self.y = self.heading = self.speed = self.rate = 0.0
        if answer is not None:
            answer.success = True
        return answer

    def hear(self, message):
        """Take a command."""
        if isinstance(message, Twist):
            self.input, self.turn = message.linear.x, message.angular.z
        elif isinstance(message, AccelStamped):
            self.input = message.accel.linear.x
        else:
            data = message.data
            self.input = float(data[0] if isinstance(message, Float64MultiArray) else data)

    def step(self):
        """Move for a period, and publish."""
        gain, tau = (self.get_parameter(name).value for name in ("gain", "tau"))
        self.speed += PERIOD / tau * (gain * self.input - self.speed)
        self.rate += PERIOD / tau * (gain * self.turn - self.rate)
        self.heading += PERIOD * self.rate
        self.x += PERIOD * self.speed * math.cos(self.heading)
        self.y += PERIOD * self.speed * math.sin(self.heading)
        stamp = self.get_clock().now().to_msg()
        if self.kind in ("angle", "process"):
            message = (Float64 if self.kind == "angle" else Float32)(data=self.x)
        elif self.kind == "speed":
            message = Float32(data=self.speed)
        elif self.kind == "joint":
            message = JointState(name=["joint"], position=[self.speed])
            message.header.stamp = stamp
        elif self.kind == "vehicle":
            # The command is an acceleration.
            message = TwistStamped()
            message.header.stamp, message.twist.linear.x = stamp, self.x
        else:
            message = Odometry() if self.kind == "robot" else PoseStamped()
            message.header.stamp = stamp
            pose = message.pose.pose if self.kind == "robot" else message.pose
            pose.position.x, pose.position.y = self.x, self.y
            pose.orientation.z = math.sin(self.heading / 2.0)
            pose.orientation.w = math.cos(self.heading / 2.0)
        self.publisher.publish(message)


KINDS = {
    "angle": (Float64, "/voltage", Float64, "/measured_angle"),
    "process": (Float32, "/control_value_topic", Float32, "/actual_state_topic"),
    "speed": (Float32, "/motor_input_u", Float32, "/motor_speed_y"),
    "joint": (Float64MultiArray, "/position_control/commands", JointState, "/joint_states"),
    "vehicle": (AccelStamped, "/accel", TwistStamped, "/vehicle_velocity"),
    "robot": (Twist, "/cmd_vel", Odometry, "/odom"),
    "localized": (Twist, "/bcr_bot/cmd_vel", PoseStamped, "/amcl_lite_pose"),
}


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Plant(sys.argv[1]))
