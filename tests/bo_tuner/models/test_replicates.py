"""Grouping of replicates, standardization and invalid data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.models.replicates import Replicates, Standardization


def repeated_data(seed=0, points=7, observations=30, dimension=3):
    rng = np.random.default_rng(seed)
    distinct = rng.random((points, dimension))
    rows = rng.integers(points, size=observations)
    return distinct[rows], rng.normal(size=observations)


def test_statistics_equal_the_naive_ones():
    x, y = repeated_data()
    data = Replicates.group(x, y)
    assert data.observations == len(y)
    assert len(np.unique(data.x, axis=0)) == len(data.x)
    np.testing.assert_array_equal(data.x[data.index], x)
    total = 0.0
    for i, point in enumerate(data.x):
        own = y[(x == point).all(axis=1)]
        assert data.count[i] == len(own)
        assert data.mean[i] == pytest.approx(own.mean(), rel=1e-13)
        total += ((own - own.mean()) ** 2).sum()
    assert data.sum_of_squares == pytest.approx(total, rel=1e-12)


@given(st.integers(0, 10_000))
def test_the_order_of_the_data_does_not_matter_to_the_last_bit(seed):
    x, y = repeated_data(seed)
    order = np.random.default_rng(seed + 1).permutation(len(y))
    one, other = Replicates.group(x, y), Replicates.group(x[order], y[order])
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.count, other.count)
    np.testing.assert_array_equal(one.index[order], other.index)
    assert one.sum_of_squares == other.sum_of_squares
    assert Standardization.of(y) == Standardization.of(y[order])


def test_within_group_sum_of_squares_survives_a_large_offset():
    y = 1e8 + np.array([1.0, 2.0, 3.0])
    assert Replicates.group(np.full((3, 1), 0.5), y).sum_of_squares == pytest.approx(2.0, rel=1e-9)


def test_standardized_responses_have_zero_mean_and_unit_deviation():
    y = np.random.default_rng(0).normal(5e-4, 1e-5, 40)
    z = Standardization.of(y).apply(y)
    assert z.mean() == pytest.approx(0.0, abs=1e-9)
    assert z.std() == pytest.approx(1.0, rel=1e-12)
    mean, variance = Standardization.of(y).restore(z, np.ones_like(z))
    np.testing.assert_allclose(mean, y, rtol=1e-13)
    np.testing.assert_allclose(variance, y.var(), rtol=1e-12)


@pytest.mark.parametrize("value", [0.0, 1.0, -3.0, 5e-4, 0.1])
def test_constant_responses_scale_with_their_magnitude(value):
    standardization = Standardization.of(np.full(7, value))
    assert standardization.scale == (abs(value) or 1.0)
    assert standardization.shift == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (np.zeros(3), np.zeros(3), r"x: expected shape \(N, d\) with N, d >= 1, found \(3,\)"),
        (np.zeros((0, 2)), np.zeros(0), r"x: expected shape .* found \(0, 2\)"),
        (np.zeros((3, 0)), np.zeros(3), r"x: expected shape .* found \(3, 0\)"),
        (np.zeros((3, 2)), np.zeros(4), r"y: expected shape \(3,\) to match x, found \(4,\)"),
        (np.zeros((2, 1)), [0.0, np.nan], r"y: expected finite values, found nan at index \(1,\)"),
        (np.zeros((2, 1)), [np.inf, 0.0], r"y: expected finite values, found inf at index \(0,\)"),
        ([[0.0, np.nan]], [0.0], r"x: expected finite values, found nan at index \(0, 1\)"),
        ([[0.5, 15.0]], [0.0], r"x: expected coordinates in the unit cube \[0, 1\], found 15"),
        ([[-0.5, 0.1]], [0.0], r"x: expected coordinates in the unit cube \[0, 1\], found -0.5"),
        ([[0.5]], [1e200], r"y: expected magnitudes below 1e\+100, found 1e\+200"),
    ],
)
def test_bad_data_are_refused(x, y, message):
    with pytest.raises(ValueError, match=message):
        Replicates.group(x, y)
