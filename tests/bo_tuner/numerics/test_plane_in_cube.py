"""Points of the unit cube in a plane, against closed forms and a solver for quadratic programs."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import beta, kstest

from bo_tuner.numerics.plane_in_cube import PlaneInCube

COUNT = 4000


@pytest.mark.parametrize("size", [2, 3, 9])
def test_the_simplex_is_drawn_uniformly(size):
    """A coordinate of Dirichlet(1, ..., 1) is Beta(1, m - 1), the sum of two Beta(2, m - 2)."""
    points = PlaneInCube(np.ones(size), 1.0).draw(COUNT, np.random.default_rng(7))
    assert np.abs(points.sum(axis=1) - 1.0).max() < 1e-12
    values = [kstest(column, beta(1, size - 1).cdf).pvalue for column in points.T]
    if size > 2:
        values.append(kstest(points[:, 0] + points[:, -1], beta(2, size - 2).cdf).pvalue)
    assert min(values) > 1e-3


def test_a_plane_with_coefficients_of_both_signs_is_drawn_uniformly():
    """Against points of the cube near the plane, of which each is as likely as any other."""
    a, b = np.array([2.0, -1.0, 0.5]), 0.4
    points = PlaneInCube(a, b).draw(COUNT, np.random.default_rng(8))
    assert np.abs(points @ a - b).max() < 1e-12
    assert points.min() >= 0.0
    assert points.max() <= 1.0
    # Free coordinates are uniform where the last one is between 0 and 1.
    free = np.random.default_rng(9).random((40_000, 2))
    last = (b - free @ a[:2]) / a[2]
    kept = free[(last >= 0.0) & (last <= 1.0)]
    assert min(kstest(points[:, k], kept[:, k]).pvalue for k in range(2)) > 1e-3


@pytest.mark.parametrize(("a", "b"), [([1.0, 1.0, 1.0], 1.0), ([2.0, -1.0, 0.5], 0.4)])
def test_the_nearest_point(a, b):
    plane, rng = PlaneInCube(np.array(a), b), np.random.default_rng(10)
    far = rng.uniform(-1.0, 2.0, (20, 3))
    nearest = plane.nearest(far)
    assert np.abs(nearest @ a - b).max() < 1e-9
    for point, found in zip(far, nearest, strict=True):
        solved = minimize(
            lambda x, point=point: ((x - point) ** 2).sum(),
            np.full(3, 0.5),
            jac=lambda x, point=point: 2.0 * (x - point),
            bounds=[(0.0, 1.0)] * 3,
            constraints={"type": "eq", "fun": lambda x: x @ a - b, "jac": lambda x: np.array(a)},
            method="SLSQP",
            options={"ftol": 1e-14},
        )
        assert np.abs(solved.x - found).max() < 1e-6


def test_a_point_in_it_stays():
    plane = PlaneInCube(np.array([2.0, -1.0, 0.5]), 0.4)
    points = plane.draw(50, np.random.default_rng(11))
    assert np.abs(plane.nearest(points) - points).max() < 1e-12
