"""Numbers out of messages, against NumPy, and what a type of message does not have."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Twist, Vector3
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bo_tuner.backends.ros.fields import ItemMissingError, field_reader
from bo_tuner.errors import StudyError
from bo_tuner.study.fields import parsed_field

INF, NAN = math.inf, math.nan


def read(message, text):
    return field_reader(type(message), parsed_field(text))(message)


def scan(*ranges):
    """A scan, whose ranges are float32."""
    return LaserScan(ranges=[float(r) for r in ranges], range_min=0.125, range_max=20.0)


@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=20))
def test_reductions_of_an_array_are_those_of_numpy(ranges):
    for name, expected in (
        ("min", np.min), ("max", np.max), ("mean", np.mean), ("sum", np.sum),
        ("norm", np.linalg.norm), ("len", len),
    ):  # fmt: skip
        assert read(scan(*ranges), f"{name}(ranges)") == pytest.approx(
            float(expected(np.array(ranges)))
        )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("min(ranges)", NAN),
        ("min(finite(ranges))", 1.5),
        ("len(finite(ranges))", 3.0),
        ("len(ranges)", 5.0),
        ("max(finite(ranges), range_max)", 20.0),
        ("min(ranges[0:2])", 3.0),
        ("min(ranges[4:])", -2.5 + 4.0),
        ("max(ranges[:1], range_min, 0.5)", 3.0),
        ("ranges[4]", 1.5),
        ("sum(min(ranges[0:2]), max(ranges[0:1]), 1)", 7.0),
    ],
)
def test_a_scan_with_ranges_that_are_none(text, expected):
    found = read(scan(3.0, 4.0, INF, NAN, 1.5), text)
    assert found == expected or (math.isnan(found) and math.isnan(expected))


def test_where_nothing_is_near_the_largest_range_stands_in():
    """`min(ranges, range_max)` of a scan in the open."""
    assert read(scan(INF, INF), "min(ranges, range_max)") == 20.0
    assert read(scan(), "min(ranges, range_max)") == 20.0


@pytest.mark.parametrize("text", ["min(ranges)", "max(finite(ranges))", "mean(ranges[9:])"])
def test_of_an_empty_array_there_is_no_such_value(text):
    empty = scan(INF) if "finite" in text else scan(*([1.0] * 3 if "[9" in text else []))
    with pytest.raises(ItemMissingError, match=r"has no values for m\w+\(\.\.\.\)") as caught:
        read(empty, text)
    assert not caught.value.names
    assert read(empty, text.replace(text[: text.index("(")], "sum")) == 0.0


def test_vectors_and_fields_of_one():
    twist = Twist(linear=Vector3(x=3.0, y=-4.0, z=12.0))
    assert read(twist, "norm(linear)") == 13.0
    assert read(twist, "norm(linear.x, linear.y)") == 5.0
    assert read(twist, "max(abs(linear))") == 12.0
    assert read(twist, "min(linear)") == -4.0
    odometry = Odometry()
    odometry.twist.twist.linear.x = -2.0
    odometry.pose.covariance[7] = 0.25
    assert read(odometry, "norm(twist.twist.linear)") == 2.0
    assert read(odometry, "sum(pose.covariance)") == 0.25
    assert read(odometry, "pose.covariance[7]") == 0.25


def test_angles_of_an_orientation():
    odometry = Odometry()
    half = 0.5 * 2.0
    odometry.pose.pose.orientation = Quaternion(z=math.sin(half), w=math.cos(half))
    assert read(odometry, "yaw(pose.pose.orientation)") == pytest.approx(2.0)
    assert read(odometry, "roll(pose.pose.orientation)") == pytest.approx(0.0)
    assert read(odometry, "max(yaw(pose.pose.orientation), 3)") == 3.0


def test_arrays_of_messages():
    poses = [Pose(position=Point(x=float(x), y=2.0)) for x in (1, 5, 3)]
    assert read(PoseArray(poses=poses), "len(poses)") == 3.0
    assert read(PoseArray(), "len(poses)") == 0.0
    assert read(PoseArray(poses=poses), "max(poses.position.x)") == 5.0
    assert read(PoseArray(poses=poses), "poses[1].position.x") == 5.0
    assert read(PoseArray(poses=poses), "max(poses[2:].position.x)") == 3.0
    assert read(Path(poses=[PoseStamped(pose=pose) for pose in poses]), "len(poses)") == 3.0
    points = [JointTrajectoryPoint(positions=[1.0, -7.0]), JointTrajectoryPoint(positions=[2.0])]
    trajectory = JointTrajectory(joint_names=["a", "b"], points=points)
    assert read(trajectory, "max(abs(points.positions))") == 7.0
    assert read(trajectory, "len(points.positions)") == 3.0
    assert read(trajectory, "len(joint_names)") == 2.0


def test_bytes_and_items_by_name():
    grid = OccupancyGrid(data=[0, 100, -1])
    assert read(grid, "max(data)") == 100.0
    assert read(grid, "min(data)") == -1.0
    state = JointState(name=["a", "b.c"], effort=[-5.0, 3.0])
    assert read(state, "max(abs(effort[a]), abs(effort[b.c]))") == 5.0
    with pytest.raises(ItemMissingError, match="has no 'd' among its names") as caught:
        read(state, "max(effort[d])")
    assert caught.value.names == ["a", "b.c"]


@pytest.mark.parametrize(
    ("cls", "text", "complaint"),
    [
        (LaserScan, "min(rangs)", "LaserScan has no field 'rangs'; did you mean 'ranges'"),
        (LaserScan, "ranges", "is an array; name one item, such as ranges.0., or a number of all"),
        (LaserScan, "min(header.frame_id)", "min is of numbers; header.frame_id is text"),
        (LaserScan, "max(header)", "max is of numbers; header is a std_msgs/msg/Header, with"),
        (LaserScan, "min(ranges.x)", "ranges is a number and has no fields"),
        (LaserScan, "len(range_max)", "len is of an array; range_max is a number"),
        (LaserScan, "yaw(ranges)", "yaw is of a quaternion; ranges is an array"),
        (LaserScan, "min(range_max[0])", r"range_max is no array; leave out \[0\]"),
        (Twist, "yaw(linear)", "yaw is of a quaternion; linear is a geometry_msgs/msg/Vector3"),
        (Twist, "norm(linear[x])", "linear is no array"),
        (Twist, "linear", "linear is a geometry_msgs/msg/Vector3; name one of its fields x, y, z"),
        (Path, "poses", r"such as poses\[0\], or len\(poses\)"),
        (Path, "poses.pose.position.x", r"poses is an array; name one item, such as poses\[0\]"),
        (Path, "max(poses)", "max is of numbers; poses is a geometry_msgs/msg/PoseStamped"),
        (JointState, "max(name)", "max is of numbers; name is text"),
        (JointState, "position", r"such as position\[0\] or position\[NAME\]"),
        (Float64, "max(data[a])", "data is no array"),
    ],
)
def test_what_messages_do_not_have(cls, text, complaint):
    with pytest.raises(StudyError, match=complaint):
        field_reader(cls, parsed_field(text))
