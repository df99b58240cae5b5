"""A node of the tuner among those that it works with."""

from collections.abc import Sequence

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from bo_tuner.errors import BackendError


def make_node(name: str, ros_arguments: Sequence[str], domain: int | None = None) -> Node:
    """Make a node with a context of its own.

    Parameters
    ----------
    name
        Its name.
    ros_arguments
        ``--ros-args``.
    domain
        ROS domain; by default that of the environment.

    Raises
    ------
    BackendError
        If ROS refuses the arguments, or the environment.
    """
    context = Context()
    try:
        rclpy.init(
            args=list(ros_arguments),
            context=context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        # It has no parameters to set, and rclpy's services for them can be made to raise.
        return Node(name, context=context, start_parameter_services=False)
    except (RuntimeError, ValueError) as error:
        context.try_shutdown()
        what = "--ros-args" if domain is not None else "--ros-args or ROS_DOMAIN_ID"
        # rcl adds where in its own sources it found the mistake.
        raise BackendError(f"cannot use {what}: {str(error).split(', at /')[0]}") from error
