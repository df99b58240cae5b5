"""Values of parameters compared."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.codec.checks import holds, same_value

DOUBLES = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e30, max_value=1e30)


@given(DOUBLES)
def test_a_node_holds_the_nearest_of_32_bits_and_no_other(told):
    held = np.float32(told)
    if held != 0.0:
        assert holds(float(held), told)
        assert holds([1.0, float(held)], [1.0, told])
    further = float(np.nextafter(held, np.float32(np.inf)))
    assert not holds(further, told) or further == told


@given(DOUBLES)
def test_that_of_more_digits_is_another_value_than_one_that_was_told_in_few(told):
    """Else a value that differs by little from what a node has would not be set."""
    held = float(np.float32(told))
    assert holds(told, held) == (told == held)


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (0.0, 1e-60),
        (True, 1),
        ("0.15", 0.15),
        (0.2, 0.15),
        (None, 0.15),
        (1e39, 1e300),
        (float(2**62), 2**62 + 1),
        ([], [0.1]),
    ],
)
def test_others_are_not(found, told):
    assert not holds(found, told)


def test_what_is_the_same_is_held():
    for value in (1, 2.5, "a", True, [1.0, 2.0], [], float("nan")):
        assert same_value(value, value)
        assert holds(value, value)
    assert holds(1.0, 1)
