"""Errors of trajectories, against poses as matrices and SciPy's rotations."""

import evo_trajectories as evo
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bo_tuner.numerics.trajectories import absolute_errors, relative_errors


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def walk(rng, count, dimension):
    return np.cumsum(rng.normal(size=(count, dimension)), axis=0)


def test_without_alignment_it_is_the_distance(rng):
    truth, estimate = walk(rng, 30, 3), walk(rng, 30, 3)
    expected = np.sqrt(((truth - estimate) ** 2).sum(axis=1))
    assert absolute_errors(truth, estimate, align=False) == pytest.approx(expected)


def test_alignment_undoes_any_motion_of_a_rigid_body(rng):
    truth = walk(rng, 30, 3)
    moved = Rotation.random(random_state=1).apply(truth) + np.array([3.0, -2.0, 8.0])
    assert absolute_errors(truth, moved, align=True) == pytest.approx(np.zeros(30), abs=1e-12)
    # A mirror image is no such motion.
    mirrored = truth * [1.0, 1.0, -1.0]
    assert absolute_errors(truth, mirrored, align=True).max() > 0.1


def test_alignment_is_the_best_rotation_of_scipy(rng):
    truth = walk(rng, 40, 3)
    estimate = truth @ Rotation.from_euler("z", 0.4).as_matrix() + rng.normal(0.0, 0.3, (40, 3))
    centred, other = truth - truth.mean(axis=0), estimate - estimate.mean(axis=0)
    rotation, distance = Rotation.align_vectors(centred, other)
    errors = absolute_errors(truth, estimate, align=True)
    assert np.sqrt((errors**2).sum()) == pytest.approx(distance)
    assert errors == pytest.approx(np.linalg.norm(rotation.apply(other) - centred, axis=1))


def pose(position, yaw):
    """A pose of the plane as a homogeneous matrix."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, position[0]], [s, c, position[1]], [0.0, 0.0, 1.0]])


def test_drift_is_that_of_poses_as_matrices(rng):
    """The translation of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) has the length of the difference of ways."""
    times = np.arange(50) * 0.1
    truth, estimate = walk(rng, 50, 2), walk(rng, 50, 2)
    yaw, other = walk(rng, 50, 1)[:, 0], walk(rng, 50, 1)[:, 0]
    moments, errors = relative_errors(times, truth, yaw, estimate, other, 1.0)
    assert moments == pytest.approx(times[10:])
    for k, error in enumerate(errors):
        q = [pose(truth[i], yaw[i]) for i in (k, k + 10)]
        p = [pose(estimate[i], other[i]) for i in (k, k + 10)]
        way, own = np.linalg.inv(q[0]) @ q[1], np.linalg.inv(p[0]) @ p[1]
        assert error == pytest.approx(np.linalg.norm((np.linalg.inv(way) @ own)[:2, 2]))


def test_drift_does_not_depend_on_the_frames(rng):
    times = np.arange(30) * 0.1
    truth, yaw = walk(rng, 30, 2), walk(rng, 30, 1)[:, 0]
    turn = pose([0.0, 0.0], 1.1)[:2, :2]
    moved = truth @ turn.T + [5.0, 4.0]
    _, errors = relative_errors(times, truth, yaw, moved, yaw + 1.1, 0.5)
    assert errors == pytest.approx(np.zeros(25), abs=1e-12)
    moments, _ = relative_errors(times, truth, yaw, moved, yaw, 10.0)
    assert len(moments) == 0


def statistics(errors):
    """As evo has them."""
    found = {"max": np.max, "mean": np.mean, "median": np.median}
    return {name: float(f(errors)) for name, f in found.items()} | {
        "rmse": float(np.sqrt(np.mean(errors**2)))
    }


def test_the_numbers_of_evo():
    """The package that most use for this, of the same two trajectories."""
    truth, estimate = evo.TRUTH, evo.ESTIMATE
    plane = np.zeros((len(truth), 1))
    places = [np.hstack([poses[:, :2], plane]) for poses in (truth, estimate)]
    for align, expected in ((False, evo.ABSOLUTE), (True, evo.ALIGNED)):
        found = statistics(absolute_errors(*places, align=align))
        assert found == pytest.approx(expected, abs=1e-6)
    _, errors = relative_errors(
        evo.TIMES, truth[:, :2], truth[:, 2], estimate[:, :2], estimate[:, 2], 1.0
    )
    assert statistics(errors) == pytest.approx(evo.RELATIVE, abs=1e-6)
