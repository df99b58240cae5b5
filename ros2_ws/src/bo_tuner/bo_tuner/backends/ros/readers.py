"""Makes the values of signals of the messages on their topics."""

from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from rclpy.node import Node

from bo_tuner.backends.ros.fields import ItemMissingError, field_reader
from bo_tuner.backends.ros.heard_topic import Heard
from bo_tuner.backends.ros.messages import has_header, interface_class, type_name
from bo_tuner.backends.ros.publishers import node_of
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.metrics.stored_messages import is_known
from bo_tuner.numerics.transforms import STILL, Transform, TransformTree, normalized
from bo_tuner.study.fields import has_names, parsed_field
from bo_tuner.study.signals import HEADER, RECEPTION, Signal

TREE, SINGLE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
"""Types of messages with transforms."""
POSE = "geometry_msgs/msg/Transform"
"""Type of one of these."""

Value = float | bytes
Stamped = tuple[int | None, Value]
"""When it was true [ns] by its stamp, None if that is its reception; and a value, or a message."""


class Reader(Protocol):
    """Takes the values of a signal out of messages."""

    def __call__(self, heard: Heard) -> Iterator[Stamped]:
        """Yield what a message says, if anything.

        Raises
        ------
        ItemMissingError
            If it has not what the signal needs.
        """


class FieldReader:
    """Reads a field, or with none the whole message.

    Attributes
    ----------
    missing : ItemMissingError or None
        What the last message that had not what the signal needs did not have.
    """

    def __init__(self, spec: Signal, cls: Any, node: str = "") -> None:
        if spec.time == HEADER and not has_header(cls):
            raise StudyError(f"{type_name(cls)} has no header; expected {RECEPTION}", ("time",))
        self._by_header = has_header(cls) and spec.time != RECEPTION
        self._node = node
        self.missing: ItemMissingError | None = None
        self._read: Callable[[Any], float] | None = None
        # One of several publishers may have the item, and the others not.
        self._skips = False
        if spec.is_number:
            with under("field"):
                self._read = field_reader(cls, parsed_field(spec.field))
            self._skips = spec.merge and has_names(parsed_field(spec.field))
        elif not is_known(type_name(cls)):
            raise StudyError(
                f"{type_name(cls)} is none of ROS's own types, of which whole messages are kept; "
                "expected a field",
                ("field",),
            )

    def __call__(self, heard: Heard) -> Iterator[Stamped]:
        """Yield what a message says."""
        if self._node and heard.node != self._node:
            return
        try:
            value = heard.data if self._read is None else self._read(heard.message)
        except ItemMissingError as error:
            self.missing = error
            if self._skips and error.names:
                return
            raise
        yield (_nanoseconds(heard.message.header) if self._by_header else None), value


class TransformFeed:
    """The transforms of a topic, and of the one with those that stand still.

    Each message is taken once, however many signals are of it.
    """

    def __init__(self) -> None:
        self.tree = TransformTree()
        self._latest: Heard | None = None

    def take(self, heard: Heard, is_static: bool) -> None:
        """Take the transforms of a message."""
        if heard is self._latest:
            return
        self._latest = heard
        message = heard.message
        for item in message.transforms if hasattr(message, "transforms") else [message]:
            place, turn = item.transform.translation, item.transform.rotation
            pose = Transform(
                np.array([place.x, place.y, place.z]),
                normalized(np.array([turn.x, turn.y, turn.z, turn.w])),
            )
            stamp = STILL if is_static else _nanoseconds(item.header)
            parent, child = (
                name.removeprefix("/") for name in (item.header.frame_id, item.child_frame_id)
            )
            self.tree.add(parent, child, stamp, pose, heard.node)


class FramesReader:
    """Reads where one frame is in another, whenever that is known of a later time."""

    def __init__(self, spec: Signal, cls: Any, feed: TransformFeed) -> None:
        if type_name(cls) not in (TREE, SINGLE):
            raise StudyError(
                f"carries {type_name(cls)}, expected transforms: {TREE} or {SINGLE}", ("topic",)
            )
        with under("field"):
            self._message = interface_class(POSE)()
            self._read = field_reader(type(self._message), parsed_field(spec.field))
        if spec.frames is None:
            raise StudyError("missing", ("frames",))
        self._target, self._source = spec.frames
        self._by_header = spec.time != RECEPTION
        self._feed = feed
        self._at = -1

    def __call__(self, heard: Heard, is_static: bool = False) -> Iterator[Stamped]:
        """Yield the value at the latest time of the whole chain, if that is another one now."""
        self._feed.take(heard, is_static)
        latest = self._feed.tree.latest(self._target, self._source)
        if latest is None or latest[0] == self._at:
            return
        self._at, pose = latest
        for part, values in (("translation", pose.translation), ("rotation", pose.rotation)):
            for name, value in zip("xyzw", values.tolist(), strict=False):
                setattr(getattr(self._message, part), name, value)
        yield (self._at if self._by_header else None), self._read(self._message)

    def still(self, heard: Heard) -> Iterator[Stamped]:
        """Yield the same of a message with transforms that stand still."""
        return self(heard, is_static=True)

    @property
    def missing(self) -> str:
        """Tell in a line why the pose is not known; empty if it is, or nothing was heard."""
        tree, pair = self._feed.tree, (self._target, self._source)
        if tree.latest(*pair) is not None or not tree.frames:
            return ""
        for frame in pair:
            if frame not in tree.frames:
                return f"no frame '{frame}'; {checks.suggestion(frame, sorted(tree.frames))}"
        if (one := tree.root(pair[0])) != (other := tree.root(pair[1])):
            return (
                f"{pair[0]} and {pair[1]} are not connected: the one is in {one}, the other in "
                f"{other}"
            )
        return f"no time at which all transforms from {pair[0]} to {pair[1]} are known"

    @property
    def mixed(self) -> str:
        """Tell in a line of a frame that two nodes place; empty if there is none."""
        for child, nodes in self._feed.tree.publishers(self._target, self._source).items():
            if len(nodes) > 1:
                return (
                    f"the transform of {child} has {len(nodes)} publishers "
                    f"({' and '.join(sorted(nodes))})"
                )
        return ""


def reader_of(
    spec: Signal, cls: Any, node: Node, feeds: dict[str, TransformFeed]
) -> FieldReader | FramesReader:
    """Return what reads a signal."""
    if spec.frames is None:
        return FieldReader(spec, cls, node_of(node, spec) if spec.publisher else "")
    topic = node.resolve_topic_name(spec.topic)
    return FramesReader(spec, cls, feeds.setdefault(topic, TransformFeed()))


def _nanoseconds(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
