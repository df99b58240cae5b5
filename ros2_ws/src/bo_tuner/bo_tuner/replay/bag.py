"""A bag of two evaluations side by side, as if both ran at the same time."""

import json
import struct
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from bo_tuner.errors import OutputError
from bo_tuner.recording.bag import NANOSECONDS, Message, Topic, TrialBag, stamp, timed

QUIET, LATEST_QUIET = 0.1, 1.0
"""Without a message for this long [s], the last one of an evaluation has come."""

_STAMP = struct.Struct("<iI")
_ENCODING = 4
"""Bytes ahead of a serialized message that tell its encoding."""


class Inbox:
    """Takes the messages of one evaluation at a time, from a listener's thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._messages: list[Message] = []
        self.lost = 0
        self.warnings: list[str] = []

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message."""
        with self._lock:
            self._messages.append((topic, data))

    def lose(self, count: int) -> None:
        """Take note of messages that the middleware has lost."""
        with self._lock:
            self.lost += count

    def warn(self, text: str) -> None:
        """Take note of a topic that cannot be heard."""
        self.warnings.append(text)

    def collect(self, hand_over: Callable[[], None]) -> list[Message]:
        """Wait for the last messages of an evaluation, and return all since the last call.

        Parameters
        ----------
        hand_over
            Makes the listener hand over what it has.
        """
        end = time.monotonic() + LATEST_QUIET
        count = -1
        # Topics have no order between them.
        while count != len(self._messages) and time.monotonic() < end:
            count = len(self._messages)
            time.sleep(QUIET)
            hand_over()
        with self._lock:
            messages, self._messages = self._messages, []
        return messages


def write_side_by_side(
    path: Path, sides: Mapping[str, list[Message]], notes: Mapping[str, object]
) -> bool:
    """Write a bag in which each side has its name in front of its topics.

    All sides begin when the first one does: the stamps in the headers of the others, and their
    times in the bag, are shifted.

    Parameters
    ----------
    path
        The bag; an older one of that name is replaced.
    sides
        Messages of an evaluation, in the order of their arrival, by name.
    notes
        Custom data of the bag.

    Returns
    -------
    bool
        Whether there was anything to write.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    starts = {name: _start(messages) for name, messages in sides.items()}
    begin = next((start for start in starts.values() if start is not None), 0)
    together: list[tuple[int, Message]] = []
    for name, messages in sides.items():
        start = starts[name]
        shift = 0 if start is None else begin - start
        moved = [_moved(message, name, shift) for message in messages]
        # What has no stamp, on a side without any, belongs to the beginning.
        together += timed(moved, begin if start is None else 0)
    if not together:
        return False
    together.sort(key=lambda item: item[0])
    text = {key: v if isinstance(v, str) else json.dumps(v) for key, v in notes.items()}
    try:
        bag = TrialBag(path)
        try:
            bag.write(together, text)
            bag.finish(text)
        except BaseException:
            bag.discard()
            raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return True


def _start(messages: list[Message]) -> int | None:
    """Time [ns] at which an evaluation begins: the first of all stamps."""
    return min((t for message in messages if (t := stamp(message)) is not None), default=None)


def _moved(message: Message, side: str, shift: int) -> Message:
    topic, data = message
    time_then = stamp(message)
    if time_then is not None and shift:
        changed = bytearray(data)
        _STAMP.pack_into(changed, _ENCODING, *divmod(time_then + shift, NANOSECONDS))
        data = bytes(changed)
    return replace(topic, name=f"/{side}{topic.name}"), data
