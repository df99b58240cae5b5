"""Writes drives of the robot, or flights, as bags: ``make_drives.py FOLDER COUNT``."""

import argparse
import math
import shutil
from pathlib import Path

import numpy as np
from attitude import flight
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


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> object:
    """Make a vector."""
    return make("Vector3", x=x, y=y, z=z)


def heading(yaw: float) -> object:
    """Make the quaternion of a heading [rad]."""
    return make("Quaternion", x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def pose(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> object:
    """Make a pose in the plane [m, rad]."""
    inner = make("Pose", position=point(x, y), orientation=heading(yaw))
    return make("PoseWithCovariance", pose=inner, covariance=np.zeros(36))


Row = tuple[float, int, str, str, dict[str, object]]
"""A message with a header: its time [s], its place among those of a time, topic, type, fields."""


def imu(rate: tuple[float, float, float], felt: tuple[float, float, float]) -> dict[str, object]:
    """Return the fields of a message of an inertial unit."""
    names = ("orientation", "angular_velocity", "linear_acceleration")
    values = (heading(0.0), vector(*rate), vector(*felt))
    covariances = {f"{name}_covariance": np.zeros(9) for name in names}
    return dict(zip(names, values, strict=True)) | covariances


def odometry(at: object, speed: float = 0.0) -> dict[str, object]:
    """Return the fields of a pose with a forward speed [m/s]."""
    twist = make("Twist", linear=vector(x=speed), angular=vector())
    twist = make("TwistWithCovariance", twist=twist, covariance=np.zeros(36))
    return {"child_frame_id": "base_link", "pose": at, "twist": twist}


def write(folder: Path, seed: int, seconds: float) -> None:
    """Write the drive of a seed."""
    made = drive(seed, seconds)
    kind = "nav_msgs/msg/Odometry"
    rows: list[Row] = [
        (time, 0, "/ground_truth", kind, odometry(pose(*(float(item) for item in place))))
        for time, place in zip(made.times, made.truth, strict=True)
    ]
    rows += [(time, 1, "/wheel/odom", kind, odometry(pose(), s)) for time, s in made.wheels]
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    rows += [(time, 2, "/fix", kind, {"pose": pose(x, y)}) for time, x, y in made.fixes]
    kind = "sensor_msgs/msg/Imu"
    rows += [(time, 3, "/imu", kind, imu((0.0, 0.0, rate), (0.0,) * 3)) for time, rate in made.gyro]
    write_bag(folder, BEGIN + 1000 * seed, rows)


def write_flight(folder: Path, seed: int, seconds: float) -> None:
    """Write the flight of a seed."""
    made = flight(seed, seconds)
    rows: list[Row] = []
    for time, (w, x, y, z) in zip(made.times, made.truth, strict=True):
        turned = make("Quaternion", w=w, x=x, y=y, z=z)
        inner = make("Pose", position=point(0.0, 0.0), orientation=turned)
        at = make("PoseWithCovariance", pose=inner, covariance=np.zeros(36))
        rows.append((time, 0, "/ground_truth", "nav_msgs/msg/Odometry", odometry(at)))
    kind = "sensor_msgs/msg/Imu"
    rows += [(time, 1, "/imu", kind, imu(rate, felt)) for time, rate, felt in made.measured]
    write_bag(folder, BEGIN + 1000 * seed, rows)


def write_bag(folder: Path, begin: int, rows: list[Row]) -> None:
    """Write messages as a bag that begins at a time [s]."""
    shutil.rmtree(folder, ignore_errors=True)
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


def main() -> None:
    """Write drives, or flights."""
    parser = argparse.ArgumentParser(description="Write drives of the robot as bags, or flights.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=1, help="number of the first one")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each")
    parser.add_argument("--flights", action="store_true", help="of the vehicle in the air")
    arguments = parser.parse_args()
    make_one, name = (write_flight, "flight") if arguments.flights else (write, "drive")
    for seed in range(arguments.first, arguments.first + arguments.count):
        make_one(arguments.folder / f"{name}_{seed}", seed, arguments.seconds)
    print(f"{arguments.count} {name}s of {arguments.seconds:g} s in {arguments.folder}")


if __name__ == "__main__":
    main()
