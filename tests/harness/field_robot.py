"""Stand-ins for nodes of a mobile robot: several that publish one topic, frames, scans, plans."""

import math

from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, LaserScan

LATCHED = QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Driver(Node):
    """Publishes `value` as a velocity at 50 Hz, by as many publishers as behaviours have."""

    def __init__(self, context, name="driver", value=1.0, publishers=1, topic="cmd_vel"):
        super().__init__(name, context=context)
        self.value = value
        self.open = [self.create_publisher(Twist, topic, 10) for _ in range(publishers)]
        self.turn = 0
        self.create_timer(0.02, self.drive)

    def drive(self):
        message = Twist()
        message.linear.x = self.value
        self.open[self.turn % len(self.open)].publish(message)
        self.turn += 1


class Wheels(Node):
    """Hears the velocity."""

    def __init__(self, context):
        super().__init__("wheels", context=context)
        self.create_subscription(Twist, "cmd_vel", lambda message: None, 10)


class Joints(Node):
    """Publishes the state of some joints at 50 Hz on /all_joints, as an arm or a gripper does."""

    def __init__(self, name, positions, *, context):
        super().__init__(name, context=context)
        self.positions = positions
        self.states = self.create_publisher(JointState, "all_joints", 10)
        self.create_timer(0.02, self.tell)

    def tell(self):
        message = JointState(name=list(self.positions), position=list(self.positions.values()))
        message.header.stamp = self.get_clock().now().to_msg()
        self.states.publish(message)


class Scanner(Node):
    """Publishes a scan at 50 Hz."""

    def __init__(self, context, ranges=(math.inf, 2.5, math.nan, 4.0)):
        super().__init__("scanner", context=context)
        self.ranges = list(ranges)
        scans = self.create_publisher(LaserScan, "scan", 10)
        self.create_timer(0.02, lambda: scans.publish(self.scan()))

    def scan(self):
        message = LaserScan(ranges=self.ranges, range_max=30.0)
        message.header.stamp = self.get_clock().now().to_msg()
        return message


class Frames(Node):
    """Tells at `rate` Hz where `child` is in `parent`: at x + speed t, turned by `yaw`."""

    def __init__(self, parent, child, *, context, x=0.0, speed=0.0, yaw=0.0, rate=50.0, name=""):
        super().__init__(name or f"{parent}_to_{child}", context=context)
        self.parent, self.child, self.x, self.speed, self.yaw = parent, child, x, speed, yaw
        self.began = self.get_clock().now()
        self.publisher = self.create_publisher(TransformStamped, "frames", 10)
        self.create_timer(1.0 / rate, lambda: self.publisher.publish(self.message()))

    def message(self):
        now = self.get_clock().now()
        message = TransformStamped(child_frame_id=self.child)
        message.header.frame_id = self.parent
        message.header.stamp = now.to_msg()
        elapsed = (now - self.began).nanoseconds * 1e-9
        message.transform.translation.x = self.x + self.speed * elapsed
        message.transform.rotation.z = math.sin(0.5 * self.yaw)
        message.transform.rotation.w = math.cos(0.5 * self.yaw)
        return message


class StillFrames(Node):
    """Tells once where `child` is in `parent`, for all who come later."""

    def __init__(self, parent, child, *, context, x=0.0):
        super().__init__(f"{parent}_to_{child}_still", context=context)
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = parent
        message.transform.translation.x = x
        self.create_publisher(TransformStamped, "frames_static", LATCHED).publish(message)


class Planner(Node):
    """Tells a plan once, from (0, y) to (10, y), for all who come later."""

    def __init__(self, context, y=1.0):
        super().__init__("planner", context=context)
        self.plans = self.create_publisher(Path, "plan", LATCHED)
        self.plan(y)

    def plan(self, y):
        path = Path()
        path.header.frame_id = "map"
        for x in (0.0, 10.0):
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = x, y
            path.poses.append(pose)
        self.plans.publish(path)
