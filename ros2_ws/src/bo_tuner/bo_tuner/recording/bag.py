"""The bag of one trial: rosbag2 in MCAP storage, metadata version 9 (ROS 2 Jazzy and Kilted).

A bag is written to ``<name>.partial`` and renamed when it is whole. Each evaluation is a chunk of
its own that is handed to the operating system as soon as it is written, so that a kill costs at
most the evaluation at hand; `bo_tuner.recording.recovery` makes a bag of what is left.
"""

import contextlib
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Final

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from bo_tuner.metrics.stored_messages import typestore
from bo_tuner.storage.atomic import write_atomically

PARTIAL = ".partial"
NOTES = "notes.json"
METADATA_VERSION: Final = 9
NANOSECONDS = 1_000_000_000

# After the four bytes of the encoding; little-endian, like all machines that ROS runs on.
_STAMP = Struct("<4xiI")


@dataclass(frozen=True)
class Topic:
    """A recorded topic.

    Attributes
    ----------
    name
        Full name.
    type
        Such as ``sensor_msgs/msg/JointState``.
    has_header
        Whether its messages begin with a ``std_msgs/Header``.
    """

    name: str
    type: str
    has_header: bool


Message = tuple[Topic, bytes]
"""Topic and serialized message (CDR)."""


def make_topic(name: str, message_type: str) -> Topic:
    """Make a topic."""
    _, fields = typestore().fielddefs[message_type]
    name_of_first, description = fields[0]
    has_header = name_of_first == "header" and "std_msgs/msg/Header" in str(description)
    return Topic(name, message_type, has_header)


def stamp(message: Message) -> int | None:
    """Time [ns] in the header of a message; None without a header, or if it is not set."""
    topic, data = message
    if not topic.has_header or len(data) < _STAMP.size:
        return None
    seconds, nanoseconds = _STAMP.unpack_from(data)
    time = int(seconds) * NANOSECONDS + int(nanoseconds)
    return time if seconds >= 0 and time > 0 else None


def timed(messages: Sequence[Message], latest: int = 0) -> list[tuple[int, Message]]:
    """Put messages in the order of simulated time."""
    stamps = [stamp(message) for message in messages]
    latest = latest or next((time for time in stamps if time is not None), 0)
    result = []
    for time, message in zip(stamps, messages, strict=True):
        if time is not None:
            latest = max(latest, time)
        result.append((latest if time is None else time, message))
    # Sorting is stable: what has the same time stays in the order of arrival.
    return sorted(result, key=lambda item: item[0])


class TrialBag:
    """A bag while it is written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.latest = 0
        self._partial = path.with_name(path.name + PARTIAL)
        if self._partial.exists():
            shutil.rmtree(self._partial)
        self._partial.mkdir(parents=True)
        # The folder within has the final name, and so has the file: rosbags names it so.
        self._writer = Writer(
            self._partial / path.name, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.open()
        self._connections: dict[str, Connection] = {}

    @property
    def empty(self) -> bool:
        """Whether no message was written."""
        return not self._connections

    def write(self, messages: Iterable[tuple[int, Message]], notes: Mapping[str, str]) -> None:
        """Append the messages of an evaluation; a kill loses neither them nor the notes."""
        for time, (topic, data) in messages:
            connection = self._connections.get(topic.name)
            if connection is None:
                connection = self._connect(topic)
            self._writer.write(connection, time, data)
            self.latest = max(self.latest, time)
        storage = self._writer.storage
        # rosbags itself writes a chunk per MiB and leaves it in its buffer.
        if isinstance(storage, McapWriter):
            if storage.chunk.bio.tell():
                storage.close_chunk()
            storage.bio.flush()
        write_atomically(self._partial / NOTES, json.dumps(dict(notes)))

    def finish(self, notes: Mapping[str, str]) -> None:
        """Close the bag with `notes` as its custom data, and give it its name."""
        for key, value in notes.items():
            self._writer.set_custom_data(key, value)
        self._writer.close()
        if self.path.exists():
            shutil.rmtree(self.path)
        (self._partial / self.path.name).rename(self.path)
        shutil.rmtree(self._partial)

    def abandon(self) -> None:
        """Close the files and leave them where they are."""
        # On a full disk closing fails, as it writes what is left.
        with contextlib.suppress(OSError):
            self._writer.abort()

    def discard(self) -> None:
        """Close and delete the files."""
        self.abandon()
        shutil.rmtree(self._partial, ignore_errors=True)

    def _connect(self, topic: Topic) -> Connection:
        connection = self._writer.add_connection(topic.name, topic.type, typestore=typestore())
        self._connections[topic.name] = connection
        return connection
