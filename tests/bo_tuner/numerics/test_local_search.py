"""Ascent on functions with a known maximum."""

import numpy as np
import pytest

from bo_tuner.numerics.local_search import ascend


def as_it_is(x):
    return x


def gap(x):
    """A slope that ends at a wall: the maximum is between them, at 0.4 - 1e-3 ln(1000) along x."""
    along = x[:, 0] - 0.4
    return x[:, 0] - np.exp(along / 1e-3) - 1e2 * ((x[:, 1:] - 0.7) ** 2).sum(axis=1)


def test_to_the_bottom_of_a_narrow_gap():
    place, value = ascend(gap, np.array([0.37, 0.69, 0.72]), as_it_is)
    best = 0.4 - 1e-3 * np.log(1e3)
    assert place == pytest.approx([best, 0.7, 0.7], abs=1e-4)
    assert value == gap(place[None])[0]


def test_in_a_corner():
    place, _ = ascend(lambda x: x.sum(axis=1), np.array([0.5, 0.9]), as_it_is)
    np.testing.assert_array_equal(place, [1.0, 1.0])


def test_an_integer_stays_and_what_is_asked_is_admissible():
    def repair(x):
        return np.column_stack([np.round(4.0 * x[:, 0]) / 4.0, x[:, 1]])

    def bowl(x):
        assert np.array_equal(x, repair(x))
        return -((x - 0.6) ** 2).sum(axis=1)

    place, _ = ascend(bowl, np.array([0.25, 0.1]), repair)
    assert place == pytest.approx([0.25, 0.6], abs=1e-5)


def test_what_is_excluded_is_not_the_answer():
    def halved(x):
        return np.where(x[:, 0] > 0.5, -np.inf, x[:, 0])

    place, value = ascend(halved, np.array([0.1]), as_it_is)
    assert 0.1 <= place[0] <= 0.5
    assert value == place[0]
