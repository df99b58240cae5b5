"""Signals as they come from a middleware that is not there."""

import contextlib
from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64, Header

from bo_tuner.backends.ros.clock import WallClock
from bo_tuner.backends.ros.signals import DEPTH, _Topic, _Track


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
    topic = _Topic("flood", "node", None, SimpleNamespace(handle=flood, msg_type=Float64), False)
    topic.poll()
    assert 0 < flood.taken <= DEPTH
    assert topic.lost.count == 0


def heard(stamps, in_run=True):
    """A track of a message each second, which tells its number and has one of `stamps` [s]."""
    track = _Track(lambda message: message.number, True, WallClock(), in_run=in_run)
    for number, stamp in enumerate(stamps):
        header = Header(stamp=Time(sec=stamp))
        track.add(SimpleNamespace(header=header, number=float(number)), number * 1_000_000_000)
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
