"""The distance of points from a line of straight pieces."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bo_tuner.numerics import polyline
from bo_tuner.numerics.polyline import distances

COORDINATES = st.floats(-100.0, 100.0)


def test_beside_beyond_and_between():
    corner = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]])
    points = np.array([[1.0, 0.5], [-3.0, 4.0], [2.0, 3.0], [1.5, 0.5], [2.0, 0.0]])
    assert distances(points, corner) == pytest.approx([0.5, 5.0, 1.0, 0.5, 0.0])


def test_a_line_of_one_point_and_pieces_without_length():
    point = np.array([[1.0, 1.0, 1.0]])
    assert distances(np.zeros((2, 3)), point) == pytest.approx([np.sqrt(3.0)] * 2)
    assert distances(np.zeros((1, 3)), np.repeat(point, 4, axis=0)) == pytest.approx(np.sqrt(3.0))


@given(
    arrays(np.float64, (5, 2), elements=COORDINATES),
    arrays(np.float64, (4, 2), elements=COORDINATES),
)
def test_no_point_of_the_line_is_nearer_and_one_is_as_near(points, vertices):
    found = distances(points, vertices)
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    pieces = itertools.pairwise(vertices)
    line = np.concatenate([(1.0 - shares) * a + shares * b for a, b in pieces])
    nearest = np.linalg.norm(points[:, None] - line, axis=2).min(axis=1)
    step = np.linalg.norm(np.diff(vertices, axis=0), axis=1).max() / 200.0
    assert np.all(found <= nearest + 1e-9)
    assert np.all(nearest <= found + step + 1e-9)


def test_many_points_are_looked_at_a_part_at_a_time(monkeypatch):
    rng = np.random.default_rng(1)
    points, vertices = rng.normal(size=(50, 3)), rng.normal(size=(9, 3))
    whole = distances(points, vertices)
    monkeypatch.setattr(polyline, "AT_ONCE", 20)
    assert np.array_equal(distances(points, vertices), whole)
