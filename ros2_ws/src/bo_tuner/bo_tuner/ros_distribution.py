"""Which ROS 2 distribution is installed, without importing it."""

import os
from importlib.metadata import PackageNotFoundError, version

WHEELS = ("jazzy", "kilted")
"""Distributions whose packages are wheels (``requirements/``)."""


def distribution() -> str:
    """Return the name of the ROS 2 distribution, in lower case.

    That of the wheels in this Python environment counts before ``ROS_DISTRO``, which may name an
    installation that is not in use. Without either it is Jazzy, for records read without ROS.
    """
    for name in WHEELS:
        try:
            version(f"ros-{name}-rclpy")
        except PackageNotFoundError:
            continue
        return name
    return os.environ.get("ROS_DISTRO", "") or WHEELS[0]
