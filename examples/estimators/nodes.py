"""What the nodes of the examples share."""

import rclpy
from builtin_interfaces.msg import Time
from rclpy.node import Node


def seconds_since(began: int | None, stamp: Time) -> tuple[int, float]:
    """Return the second of the first stamp, and the time [s] from there to another one.

    A double holds a time since 1970 to within a quarter of a microsecond only.
    """
    began = stamp.sec if began is None else began
    return began, stamp.sec - began + 1e-9 * stamp.nanosec


def spin(node: Node) -> None:
    """Run a node until it is to end."""
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
