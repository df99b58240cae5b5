"""Whether a condition has come to hold, of its values over time."""

import numpy as np
import pytest

from bo_tuner.backends.ros.conditions import Edge

NAN = np.nan


def rises(hold, *looks):
    """Whether it has come to hold after the last of several looks."""
    edge = Edge(hold)
    found = [edge.look(np.array(times), np.array(values)) for times, values in looks]
    assert not any(found[:-1])
    return found[-1]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 1, 1], False),
        ([0, 0, 0], False),
        ([1, 0, 1], True),
        # A pulse that is over by now has been an edge, too.
        ([0, 1, 0], True),
        ([0, NAN, 1], True),
        # What was not known has not been off.
        ([NAN, NAN, 1], False),
    ],
)
def test_an_edge(values, expected):
    assert rises(0.0, ([0.0, 0.1, 0.2], values)) is expected


def test_an_edge_that_comes_with_a_later_look():
    assert rises(0.0, ([0.0, 0.1], [1, 0]), ([0.1, 0.2], [0, 0]), ([0.2, 0.3], [0, 1]))


def test_what_was_high_before_is_no_edge_when_it_is_seen_again():
    seen = ([0.0, 0.1], [1, 1]), ([0.0, 0.1, 0.2], [1, 1, 0]), ([0.0, 0.1, 0.3], [1, 1, 0])
    assert not rises(0.0, *seen)
    assert rises(0.0, *seen, ([0.1, 0.3, 0.4], [1, 0, 1]))


def test_it_must_hold_as_long_as_it_says():
    assert not rises(0.3, ([0.0, 0.1, 0.3], [0, 1, 1]))
    assert rises(0.3, ([0.0, 0.1, 0.3], [0, 1, 1]), ([0.1, 0.4], [1, 1]))
    # Not if it ceased to meanwhile, or nobody knows.
    assert not rises(0.3, ([0.0, 0.1, 0.2], [0, 1, 0]), ([0.3, 0.5], [1, 1]))
    assert not rises(0.3, ([0.0, 0.1, 0.2], [0, 1, NAN]), ([0.3, 0.5], [1, 1]))
