"""Frames in frames, against homogeneous matrices and SciPy's slerp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from bo_tuner.numerics.transforms import STILL, Transform, TransformTree, interpolated, normalized

SECOND = 1_000_000_000


def pose(rng):
    """Any pose."""
    return Transform(rng.normal(size=3), Rotation.random(random_state=rng).as_quat())


def matrix(transform):
    """The homogeneous matrix (4, 4)."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(transform.rotation).as_matrix()
    found[:3, 3] = transform.translation
    return found


def at(x):
    """A pose that is only a translation."""
    return Transform(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))


@given(st.integers(0, 1000))
def test_composition_and_inverse_are_those_of_matrices(seed):
    rng = np.random.default_rng(seed)
    one, other = pose(rng), pose(rng)
    assert matrix(one @ other) == pytest.approx(matrix(one) @ matrix(other))
    assert matrix(one.inverse) == pytest.approx(np.linalg.inv(matrix(one)))


@given(st.integers(0, 1000), st.floats(0.0, 1.0))
def test_between_two_poses(seed, share):
    rng = np.random.default_rng(seed)
    one, other = pose(rng), pose(rng)
    between = interpolated(one, other, share)
    expected = Slerp([0.0, 1.0], Rotation.from_quat([one.rotation, other.rotation]))(share)
    assert (Rotation.from_quat(between.rotation) * expected.inv()).magnitude() < 1e-6
    moved = one.translation + share * (other.translation - one.translation)
    assert between.translation == pytest.approx(moved)
    # A quaternion and its negative are the same rotation.
    turned = interpolated(Transform(one.translation, -one.rotation), other, share)
    assert matrix(turned) == pytest.approx(matrix(between), abs=1e-6)


def test_a_rotation_of_zeros_is_none():
    assert np.isnan(normalized(np.zeros(4))).all()
    assert normalized(np.array([0.0, 0.0, 3.0, 4.0])) == pytest.approx([0.0, 0.0, 0.6, 0.8])


def test_a_chain_over_the_frame_that_both_are_in():
    """Up from the target, and down to the source; one link of it stands still."""
    rng = np.random.default_rng(3)
    links = {("map", "odom"): 5, ("odom", "base"): 5, ("base", "laser"): STILL, ("map", "goal"): 5}
    poses = {pair: pose(rng) for pair in links}
    tree = TransformTree()
    for (parent, child), stamp in links.items():
        tree.add(parent, child, stamp, poses[parent, child])
    stamp, found = tree.latest("goal", "laser")
    chain = [("map", "odom"), ("odom", "base"), ("base", "laser")]
    expected = np.linalg.inv(matrix(poses["map", "goal"]))
    for pair in chain:
        expected = expected @ matrix(poses[pair])
    assert stamp == 5
    assert matrix(found) == pytest.approx(expected)
    assert matrix(tree.latest("laser", "goal")[1]) == pytest.approx(np.linalg.inv(expected))
    assert tree.frames == {"map", "odom", "base", "laser", "goal"}


def test_the_latest_time_that_the_whole_chain_knows():
    """The link that is ahead is interpolated at the time of the one behind."""
    tree = TransformTree()
    tree.add("map", "odom", 0, at(0.0))
    tree.add("odom", "base", SECOND, at(1.0))
    tree.add("map", "odom", 4 * SECOND, at(8.0))
    stamp, found = tree.latest("map", "base")
    assert stamp == SECOND
    assert found.translation == pytest.approx([2.0 + 1.0, 0.0, 0.0])
    tree.add("odom", "base", 9 * SECOND, at(2.0))
    stamp, found = tree.latest("map", "base")
    assert stamp == 4 * SECOND
    assert found.translation == pytest.approx([8.0 + 1.0 + 3.0 / 8.0, 0.0, 0.0])


def test_no_pose_without_a_way_or_a_common_time():
    tree = TransformTree()
    assert tree.latest("map", "base") is None
    tree.add("map", "odom", 5, at(1.0))
    tree.add("other", "base", 5, at(1.0))
    assert tree.latest("map", "base") is None
    assert (tree.root("odom"), tree.root("base")) == ("map", "other")
    tree.add("odom", "base", 2, at(1.0))
    assert tree.latest("map", "base") is None, "of the time 2 the first link is unknown"


def test_frames_in_a_circle_are_no_tree():
    tree = TransformTree()
    tree.add("a", "b", 1, at(1.0))
    tree.add("b", "a", 1, at(1.0))
    assert tree.latest("a", "c") is None
    assert tree.latest("a", "b")[1].translation == pytest.approx([1.0, 0.0, 0.0])


def test_a_simulation_that_was_reset_begins_anew():
    """What was said of later times holds no more."""
    tree = TransformTree()
    for second in range(5):
        tree.add("map", "base", second * SECOND, at(float(second)))
    tree.add("map", "base", SECOND // 2, at(7.0))
    stamp, found = tree.latest("map", "base")
    assert (stamp, found.translation[0]) == (SECOND // 2, 7.0)


def test_a_frame_may_get_another_parent():
    tree = TransformTree()
    tree.add("map", "cup", 1, at(1.0))
    tree.add("map", "hand", 2, at(5.0))
    tree.add("hand", "cup", 2, at(0.5))
    assert tree.latest("map", "cup")[1].translation[0] == 5.5


def test_old_poses_are_forgotten():
    tree = TransformTree()
    for second in range(200):
        tree.add("map", "base", second * SECOND, at(float(second)))
    (link,) = tree._links.values()
    assert len(link.stamps) == len(link.poses) <= 21
    assert tree.latest("map", "base")[1].translation[0] == 199.0


def test_who_places_a_frame():
    tree = TransformTree()
    for node in ("/ekf", "/odometry", "/ekf"):
        tree.add("odom", "base", 1, at(0.0), node)
    tree.add("map", "odom", 1, at(0.0), "/amcl")
    expected = {"odom": {"/amcl"}, "base": {"/ekf", "/odometry"}}
    assert tree.publishers("map", "base") == expected
    tree.begin()
    assert tree.publishers("map", "base") == {"odom": set(), "base": set()}
