"""Transforms as `/tf` has them: many in a message, static ones on a topic of their own."""

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Float64

from bo_tuner.backends.ros.heard_topic import Heard
from bo_tuner.backends.ros.readers import FramesReader, TransformFeed
from bo_tuner.errors import StudyError
from bo_tuner.study.signals import Signal

# The wheels have no tf2_msgs: a class of that name, in a module of that name, stands in for it.
TFMessage = type("TFMessage", (), {"__module__": "tf2_msgs.msg._tf_message"})


def transform(parent, child, x, seconds=0):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp.sec = seconds
    message.transform.translation.x = x
    return message


def heard(*transforms, node=""):
    return Heard(b"", SimpleNamespace(transforms=list(transforms)), 0, node)


def reader(field="translation.x", feed=None):
    signal = Signal(name="x", frames=["map", "laser"], field=field)
    return FramesReader(signal, TFMessage, feed or TransformFeed())


def test_a_chain_in_messages_of_several_transforms():
    """Names with a slash ahead, as of old, are those without one."""
    read = reader()
    assert not list(read(heard(transform("/map", "/odom", 1.0, 2), transform("a", "b", 9.0, 4))))
    assert not list(read(heard(transform("map", "odom", 1.0, 4))))
    assert not list(read(heard(transform("base", "laser", 0.25)), is_static=True))
    assert list(read(heard(transform("odom", "base", 2.0, 3)))) == [(3_000_000_000, 3.25)]
    # What is no news is no value: a frame elsewhere, and one that is ahead.
    assert not list(read(heard(transform("a", "b", 8.0, 5))))
    assert not list(read(heard(transform("map", "odom", 1.0, 6))))
    ((stamp, value),) = read(heard(transform("odom", "base", 5.0, 6)))
    assert (stamp, value) == (6_000_000_000, 6.25)


def test_signals_of_one_topic_share_its_transforms():
    """Each message is taken once, and read by all."""
    feed = TransformFeed()
    one, other = reader(feed=feed), reader("norm(translation)", feed)
    message = heard(transform("map", "laser", -2.0, 1))
    assert [v for _, v in one(message)] == [-2.0]
    assert [v for _, v in other(message)] == [2.0]


def test_by_reception():
    signal = Signal(name="x", frames=["map", "laser"], field="translation.x", time="reception")
    read = FramesReader(signal, TFMessage, TransformFeed())
    assert list(read(heard(transform("map", "laser", 1.0, 5)))) == [(None, 1.0)]


def test_a_frame_of_two_nodes_is_named():
    read = reader()
    list(read(heard(transform("map", "laser", 1.0, 5), node="/ekf")))
    assert read.mixed == ""
    list(read(heard(transform("map", "laser", 2.0, 6), node="/odometry")))
    assert read.mixed == "the transform of laser has 2 publishers (/ekf and /odometry)"


def test_a_rotation_of_zeros_has_no_angle():
    message = transform("map", "laser", 1.0, 5)
    message.transform.rotation.w = 0.0
    ((_, value),) = reader("yaw(rotation)")(heard(message))
    assert value != value


@pytest.mark.parametrize(
    ("cls", "field", "complaint"),
    [
        (Float64, "translation.x", "topic: carries std_msgs/msg/Float64, expected transforms"),
        (TFMessage, "data", "field: geometry_msgs/msg/Transform has no field 'data'"),
        (TFMessage, "translation", "field: translation is a geometry_msgs/msg/Vector3; name one"),
    ],
)
def test_refused(cls, field, complaint):
    signal = Signal(name="x", frames=["map", "laser"], field=field)
    with pytest.raises(StudyError, match=complaint):
        FramesReader(signal, cls, TransformFeed())
