"""Writes drives of the robot as bags: ``make_drives.py FOLDER COUNT [SECONDS]``."""

import math
import shutil
import sys
from pathlib import Path

import numpy as np
from robot import drive
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

BEGIN = 1_700_000_000
"""Time [s] of the first drive."""
TYPES = get_typestore(Stores.ROS2_JAZZY)


def make(kind: str, **fields: object) -> object:
    """Make a message, as ``make("Point", x=0.0, y=0.0, z=0.0)``."""
    packages = ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "builtin_interfaces")
    (cls,) = (TYPES.types[n] for p in packages if (n := f"{p}/msg/{kind}") in TYPES.types)
    return cls(**fields)


def point(x: float, y: float) -> object:
    """Make a point of the plane [m]."""
    return make("Point", x=x, y=y, z=0.0)


def vector(x: float = 0.0, z: float = 0.0) -> object:
    """Make a vector."""
    return make("Vector3", x=x, y=0.0, z=z)


def heading(yaw: float) -> object:
    """Make the quaternion of a heading [rad]."""
    return make("Quaternion", x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def pose(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> object:
    """Make a pose in the plane [m, rad]."""
    inner = make("Pose", position=point(x, y), orientation=heading(yaw))
    return make("PoseWithCovariance", pose=inner, covariance=np.zeros(36))


def write(folder: Path, seed: int, seconds: float) -> None:
    """Write the drive of a seed."""
    shutil.rmtree(folder, ignore_errors=True)
    made, begin = drive(seed, seconds), BEGIN + 1000 * seed
    rows: list[tuple[float, int, str, str, dict[str, object]]] = []

    def odometry(topic: str, place: int, time: float, at: object, speed: float) -> None:
        twist = make("Twist", linear=vector(x=speed), angular=vector())
        twist = make("TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        fields = {"child_frame_id": "base_link", "pose": at, "twist": twist}
        rows.append((time, place, topic, "nav_msgs/msg/Odometry", fields))

    for time, (x, y, yaw) in zip(made.times, made.truth, strict=True):
        odometry("/ground_truth", 0, time, pose(float(x), float(y), float(yaw)), 0.0)
    for time, speed in made.wheels:
        odometry("/wheel/odom", 1, time, pose(), speed)
    for time, x, y in made.fixes:
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        rows.append((time, 2, "/fix", kind, {"pose": pose(x, y)}))
    for time, rate in made.gyro:
        fields = {
            "orientation": heading(0.0),
            "angular_velocity": vector(z=rate),
            "linear_acceleration": vector(),
        }
        names = ("orientation", "angular_velocity", "linear_acceleration")
        fields |= {f"{name}_covariance": np.zeros(9) for name in names}
        rows.append((time, 3, "/imu", "sensor_msgs/msg/Imu", fields))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for time, _, topic, kind, fields in sorted(rows, key=lambda row: row[:2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            nanoseconds = begin * 1_000_000_000 + round(time * 1e9)
            sec, nanosec = divmod(nanoseconds, 1_000_000_000)
            header = make("Header", stamp=make("Time", sec=sec, nanosec=nanosec), frame_id="odom")
            message = TYPES.types[kind](header=header, **fields)
            data = TYPES.serialize_cdr(message, kind)
            writer.write(connections[topic], nanoseconds, data)


def main(folder: str, count: str, seconds: str = "60") -> None:
    """Write drives of the first seeds."""
    for seed in range(int(count)):
        write(Path(folder) / f"drive_{seed + 1}", seed + 1, float(seconds))
    print(f"{count} drives of {seconds} s in {folder}")


if __name__ == "__main__":
    main(*sys.argv[1:])
