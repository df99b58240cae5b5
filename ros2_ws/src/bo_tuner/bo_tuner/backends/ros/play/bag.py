"""A bag that is played: its topics, and its messages in the order in which they come."""

import heapq
import zlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError

from bo_tuner.backends.ros.others import OF_ROS
from bo_tuner.errors import StudyError
from bo_tuner.text import one_line

STAMP = slice(4, 12)
"""Bytes of a message that are the stamp of its header, after those that tell the encoding."""
DATED = 1_000_000_000 * 1_000_000_000
"""Times [ns] after this one, in 2001, are of a clock that tells the date."""
SET_BACK = 1.0
"""Time [s] by which a stamp that is behind one before it is not just late."""
APART = 60.0
"""Time [s] by which stamps may differ from the times at which the bag has recorded them."""


class Message(NamedTuple):
    """A message: when it is played [ns], its topic in the bag, and its bytes."""

    time: int
    topic: str
    data: bytes


class Bag:
    """A bag, read anew each time that it is played.

    Attributes
    ----------
    types : mapping from str to str
        Types of its topics, without those that are not played.
    start, end : int
        Times [ns] of its first message, and after its last one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with Reader(path) as reader:
                connections = [c for c in reader.connections if c.topic not in OF_ROS]
                self.types = {c.topic: c.msgtype for c in connections}
                self.start, self.end = reader.start_time, reader.end_time
                count = reader.message_count
        except (ReaderError, OSError, ValueError) as error:
            raise self._unreadable(error) from None
        if not count:
            raise self._error("has no messages")

    def overlaps(self, other: "Bag") -> bool:
        """Whether another one has been recorded at the same time, by clocks that tell the date."""
        # A bag may begin with the last message of another one.
        begins, last = max(self.start, other.start), min(self.end, other.end) - 1
        return begins > DATED and begins < last

    def check(self, topics: Collection[str], stamped: Collection[str]) -> None:
        """Read some topics once, and refuse what cannot be played.

        Messages of those that are `stamped` begin with a header.
        """
        newest: dict[str, int] = {}
        for message in self.messages(topics, 0.0, None, {}, {}):
            if message.topic not in stamped:
                continue
            stamp = stamp_of(message.data)
            if not stamp:
                continue
            at = f"at {(message.time - self.start) * 1e-9:.3f} s of the bag"
            if (back := (newest.get(message.topic, 0) - stamp) * 1e-9) > SET_BACK:
                raise self._error(f"the stamps of {message.topic} go back by {back:.3g} s {at}")
            if (apart := abs(message.time - stamp) * 1e-9) > APART:
                raise self._error(
                    f"the stamps of {message.topic} are {apart:.3g} s from the times at which the "
                    f"bag has recorded them, {at}; expected a bag of one clock"
                )
            newest[message.topic] = max(stamp, newest.get(message.topic, 0))

    def messages(
        self,
        topics: Collection[str],
        begin: float,
        end: float | None,
        delay: Mapping[str, float],
        drop: Mapping[str, float],
    ) -> Iterator[Message]:
        """Yield the messages of some topics in the order of their times."""
        first = self.start + round(begin * 1e9)
        last = self.end if end is None else min(self.end, self.start + round(end * 1e9))
        try:
            with Reader(self.path) as reader:
                # Messages that come equally late are in order already.
                late: dict[float, list[Connection]] = {}
                for connection in reader.connections:
                    if connection.topic in topics:
                        late.setdefault(delay.get(connection.topic, 0.0), []).append(connection)
                parts = [
                    self._read(reader, connections, first, last, round(by * 1e9))
                    for by, connections in late.items()
                ]
                kept = {name: _Kept(name, share) for name, share in drop.items()}
                for message in heapq.merge(*parts, key=lambda item: item.time):
                    if message.topic not in kept or kept[message.topic].next():
                        yield message
        except (ReaderError, OSError, ValueError) as error:
            raise self._unreadable(error) from None

    @staticmethod
    def _read(
        reader: Reader, connections: list[Connection], first: int, last: int, by: int
    ) -> Iterator[Message]:
        for connection, time, data in reader.messages(connections, first, last):
            if time + by < last:
                yield Message(time + by, connection.topic, bytes(data))

    def _unreadable(self, error: Exception) -> StudyError:
        if isinstance(error, FileNotFoundError) or not self.path.exists():
            return self._error("there is no such file or folder with metadata.yaml")
        return self._error(
            f"cannot be read: {one_line(str(error))}; was its recording cut off? `ros2 bag "
            "reindex` or `mcap recover` mends that"
        )

    def _error(self, problem: str) -> StudyError:
        return StudyError(f"'{self.path}': {problem}", ("bag",))


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] of a message that begins with a header."""
    order = "<" if data[1] & 1 else ">"
    sec, nanosec = np.frombuffer(data[STAMP], dtype=[("s", f"{order}i4"), ("ns", f"{order}u4")])[0]
    return int(sec) * 1_000_000_000 + int(nanosec)


class _Kept:
    """Which messages of a topic are played, each time the same ones."""

    def __init__(self, topic: str, dropped: float) -> None:
        self._rng = np.random.default_rng(zlib.crc32(topic.encode()))
        self._dropped = dropped

    def next(self) -> bool:
        """Whether the next message is played."""
        return bool(self._rng.random() >= self._dropped)
