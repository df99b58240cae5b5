"""The messages of the closed loop: their quality of service, how they are made and read.

The stamp is the sequence number: a cut starts at the stamp of its reference trajectory, sample k
is stamped k sample times later, and a command carries the stamp of the measurement that it
answers. A cut's identifier is its start, written as seconds and nanoseconds.
"""

from collections.abc import Mapping
from math import isfinite

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from feed_axis_common.errors import MessageError
from feed_axis_common.model import Array

LOOP_QOS = QoSProfile(
    depth=10,
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.VOLATILE,
)
"""Of all topics of the loop.

Reliable topics too lose what exceeds their depth. Volatile, so that nobody gets an old command.
"""

NANOSECONDS = 1_000_000_000
LATEST_SECOND = 2**31 - 1


def to_stamp(time: int) -> Time:
    """Make a stamp of a time [ns]."""
    return Time(sec=time // NANOSECONDS, nanosec=time % NANOSECONDS)


def from_stamp(stamp: Time | Duration) -> int:
    """Read a stamp or a duration [ns]."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def is_time(time: int) -> bool:
    """Whether a time [ns] fits into a stamp, whose seconds have 32 bits: 1970 to 2038."""
    return 0 <= time < LATEST_SECOND * NANOSECONDS


def cut_identifier(start: int) -> str:
    """Name the cut that starts at `start` [ns]."""
    return f"{start // NANOSECONDS}.{start % NANOSECONDS:09d}"


class VelocityPublisher:
    """Publishes the velocity of a joint.

    It has one message and changes it, as making one for each sample costs as much as sending it.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._publisher = node.create_publisher(JointState, topic, LOOP_QOS)
        self._message = JointState(name=[""], velocity=[0.0])

    @property
    def subscription_count(self) -> int:
        """Number of subscriptions that are connected."""
        return int(self._publisher.get_subscription_count())

    def publish(self, joint: str, time: int, velocity: float) -> None:
        """Send the velocity [m/s] of `joint` at `time` [ns]."""
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time, NANOSECONDS)
        self._message.name[0] = joint
        self._message.velocity[0] = float(velocity)
        self.repeat()

    def repeat(self) -> None:
        """Send the last velocity again."""
        self._publisher.publish(self._message)


def read_joint_velocity(message: JointState, joint: str) -> float | None:
    """Velocity [m/s] of a joint, or None if the message lacks it or has no valid stamp."""
    if joint not in message.name or len(message.velocity) != len(message.name):
        return None
    if not is_time(from_stamp(message.header.stamp)):
        return None
    return float(message.velocity[message.name.index(joint)])


def velocity_trajectory(
    joint: str, start: int, velocity: Array, sample_time: float
) -> JointTrajectory:
    """Message with a velocity [m/s] for each sample, from `start` [ns] on."""
    times = (np.arange(velocity.size) * sample_time * NANOSECONDS).round().astype(int).tolist()
    return JointTrajectory(
        header=Header(stamp=to_stamp(start)),
        joint_names=[joint],
        points=[
            JointTrajectoryPoint(
                velocities=[v],
                time_from_start=Duration(sec=t // NANOSECONDS, nanosec=t % NANOSECONDS),
            )
            for v, t in zip(velocity.tolist(), times, strict=True)
        ],
    )


def read_velocity_trajectory(
    message: JointTrajectory, joint: str, sample_time: float
) -> list[float]:
    """Velocities [m/s] of a joint, a point for each sample.

    Raises
    ------
    MessageError
        If the joint is not in the message, a point lacks its velocity or has one that is not
        finite, or the points are not one sample time apart.
    """
    if joint not in message.joint_names:
        raise MessageError(
            f"reference: no joint {joint}, found {', '.join(message.joint_names) or 'none'}"
        )
    index = message.joint_names.index(joint)
    velocities = []
    for k, point in enumerate(message.points):
        if len(point.velocities) != len(message.joint_names):
            raise MessageError(f"reference: point {k} has no velocity for joint {joint}")
        velocity = float(point.velocities[index])
        if not isfinite(velocity):
            raise MessageError(f"reference: velocity of point {k} is {velocity}")
        if abs(from_stamp(point.time_from_start) - k * sample_time * NANOSECONDS) > 1000:
            raise MessageError(
                f"reference: point {k} is {from_stamp(point.time_from_start) / NANOSECONDS} s from "
                f"the start; expected {k * sample_time:g} s, one sample time per point"
            )
        velocities.append(velocity)
    return velocities


def cut_result(
    node: str, joint: str, start: int, stamp: int, result: Mapping[str, float | str]
) -> DiagnosticArray:
    """Message with the summary of a cut.

    Parameters
    ----------
    node
        Name of the node; the status is called ``<node>: cut_result`` in every cut (REP 107).
    joint
        Name of the axis, the hardware id.
    start
        Start of the cut [ns], its identifier.
    stamp
        Time of the message [ns].
    result
        The result; from ``status`` comes the level, OK if it is ``ok``, and ``reason`` is the
        message. Numbers are written so that they can be read back exactly.
    """
    ok = result["status"] == "ok"
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK if ok else DiagnosticStatus.ERROR,
        name=f"{node}: cut_result",
        hardware_id=joint,
        message=str(result["reason"]),
        values=[
            KeyValue(key=key, value=value if isinstance(value, str) else repr(value))
            for key, value in ({"cut": cut_identifier(start)} | dict(result)).items()
        ],
    )
    return DiagnosticArray(header=Header(stamp=to_stamp(stamp)), status=[status])
