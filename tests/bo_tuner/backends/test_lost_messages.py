"""Gaps in the numbers of messages, and what is none."""

import pytest

from bo_tuner.backends.ros.lost_messages import LostMessages


@pytest.mark.parametrize(
    ("numbers", "count"),
    [
        ([1, 2, 3], 0),
        ([1, 2, 6, 8], 4),
        ([7, 8], 0),
        ([7, 8, 1, 2], 0),
        ([1, None, 5, 0, 9], 0),
    ],
    ids=["none", "gaps", "joined late", "started anew", "not numbered"],
)
def test_of_one_publisher_each_gap_counts(numbers, count):
    lost = LostMessages()
    for number in numbers:
        lost.note(number, publishers=1)
    assert lost.count == count


def test_beside_a_second_publisher_no_gap_counts():
    """It joins with numbers of its own, and leaves again."""
    lost = LostMessages()
    for number, publishers in ((1, 1), (2, 1), (500, 2), (3, 2), (501, 2), (4, 1), (5, 1), (7, 1)):
        lost.note(number, publishers)
    assert lost.count == 1
