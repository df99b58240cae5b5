"""Signals as they come from a middleware that is not there."""

import contextlib
from types import SimpleNamespace

from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from bo_tuner.backends.ros.signals import DEPTH, _Topic


class Flood(contextlib.nullcontext):
    """The subscription of a topic that always has another message."""

    taken = 0

    def take_message(self, _type, _raw):
        self.taken += 1
        info = {"publication_sequence_number": self.taken, "received_timestamp": self.taken}
        return serialize_message(Float64(data=float(self.taken))), info


def test_a_topic_faster_than_its_reader_lets_the_reader_go_on():
    flood = Flood()
    topic = _Topic("flood", None, SimpleNamespace(handle=flood, msg_type=Float64), False)
    topic.poll()
    assert 0 < flood.taken <= DEPTH
    assert topic.lost == 0
