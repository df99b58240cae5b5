"""Numbers of arrays, against NumPy, and angles, against SciPy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from bo_tuner.numerics.reductions import ANGLES, FILTERS, REDUCTIONS, EmptyArrayError

VALUES = arrays(np.float64, st.integers(1, 30), elements=st.floats(-1e6, 1e6))


@given(VALUES)
def test_reductions_are_those_of_numpy(values):
    for name, expected in (
        ("min", np.amin), ("max", np.amax), ("mean", np.average), ("sum", np.sum),
    ):  # fmt: skip
        assert REDUCTIONS[name](values) == pytest.approx(expected(values), abs=1e-6)
    assert REDUCTIONS["norm"](values) == pytest.approx(math.hypot(*values))


def test_what_is_not_finite_counts_unless_it_is_left_out():
    values = np.array([3.0, np.inf, 2.0, np.nan])
    assert all(math.isnan(REDUCTIONS[name](values)) for name in REDUCTIONS)
    assert REDUCTIONS["max"](values[:3]) == math.inf
    assert list(FILTERS["finite"](values)) == [3.0, 2.0]


def test_of_an_empty_array_there_is_a_sum_but_no_least_value():
    for name in ("min", "max", "mean"):
        with pytest.raises(EmptyArrayError):
            REDUCTIONS[name](np.empty(0))
    assert REDUCTIONS["sum"](np.empty(0)) == REDUCTIONS["norm"](np.empty(0)) == 0.0


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(0.1, 10.0))
def test_angles_of_a_quaternion_of_any_length(roll, pitch, yaw, length):
    """REP 103: about the fixed axes x, y, z, one after the other."""
    quaternion = length * Rotation.from_euler("xyz", [roll, pitch, yaw]).as_quat()
    found = [ANGLES[name](quaternion) for name in ("roll", "pitch", "yaw")]
    assert found == pytest.approx([roll, pitch, yaw], abs=1e-6)


def test_a_quaternion_of_zeros_has_no_angle():
    assert all(math.isnan(angle(np.zeros(4))) for angle in ANGLES.values())


def test_straight_up_is_a_right_angle_in_spite_of_rounding():
    up = np.array([0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)]) * 1.1
    assert ANGLES["pitch"](up) == pytest.approx(math.pi / 2)
