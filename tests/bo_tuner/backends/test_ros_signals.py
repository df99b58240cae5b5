"""Signals as they come from a middleware that is not there."""

import contextlib
from types import SimpleNamespace

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from bo_tuner.backends.ros.clock import WallClock
from bo_tuner.backends.ros.heard_topic import DEPTH, HeardTopic
from bo_tuner.backends.ros.tracks import Track


class Flood(contextlib.nullcontext):
    """The subscription of a topic that always has another message."""

    taken = 0

    def take_message(self, _type, _raw):
        self.taken += 1
        info = {"publication_sequence_number": self.taken, "received_timestamp": self.taken}
        return serialize_message(Float64(data=float(self.taken))), info

    def get_publisher_count(self):
        return 1


def test_a_topic_faster_than_its_reader_lets_the_reader_go_on():
    flood = Flood()
    subscription = SimpleNamespace(handle=flood, msg_type=Float64)
    node = SimpleNamespace(create_subscription=lambda *args, **named: subscription)
    topic = HeardTopic(node, "flood", Float64, [])
    values = [heard.message.data for heard in topic.take()]
    assert values == list(range(1, flood.taken + 1))
    assert 0 < flood.taken <= DEPTH
    assert topic.lost() == 0


def heard(stamps, in_run=True):
    """A track of a message each second, which tells its number and has one of `stamps` [s]."""
    track = Track(WallClock(), in_run=in_run)
    for number, stamp in enumerate(stamps):
        track.add(stamp * 1_000_000_000, float(number), number * 1_000_000_000)
    return track


@pytest.mark.parametrize(
    ("stamps", "stale", "late"),
    [
        ([10, 11, 12, 13], 0, []),
        ([10, 12, 11, 13, 15, 14], 0, [2, 5, 5]),
        ([10, 99, 12, 13, 14], 86, [2, 3, 4, 4]),
        ([10, 11, 5, 6], 5, [2, 3, 3]),
        ([0, 0, 0, 0, 0], 3, [1, 2, 3, 4, 4]),
    ],
    ids=["in order", "reordered", "one ahead", "set back", "none"],
)
def test_stamps_that_do_not_go_on(stamps, stale, late):
    """How long a message after a late one is late, too, and what late ones say, with the last."""
    track = heard(stamps)
    assert track.stale == stale * 1_000_000_000
    assert list(track.take_late()) == late


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        # Sent ten times as often as it is measured.
        ([10, 10, 11, 11, 12], ([10, 11, 12], [1.0, 3.0, 4.0])),
        # A simulation that was reset.
        ([10, 11, 0, 1], ([0, 1], [2.0, 3.0])),
        ([10, 12, 11, 13], ([10, 11, 13], [0.0, 2.0, 3.0])),
    ],
)
def test_outside_of_a_run_what_came_last_of_a_stamp_holds(stamps, kept):
    """A condition may have to hold for longer than one stamp."""
    track = heard(stamps, in_run=False)
    assert ([stamp // 1_000_000_000 for stamp in track.stamps], track.values) == kept
