"""A bag of two evaluations side by side, shifted to the same start time."""

import json
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from bo_tuner.recording.bag import NANOSECONDS, Message, TrialBag, stamp, timed
from bo_tuner.storage.atomic import writing

QUIET, LATEST_QUIET = 0.1, 1.0
"""Time without a message [s] after which an evaluation's last one has arrived; longest wait [s]."""

_STAMP = struct.Struct("<iI")
_ENCODING = 4
"""Length of the encapsulation header of a serialized message [byte]."""


def write_side_by_side(
    path: Path, sides: Mapping[str, list[Message]], notes: Mapping[str, object]
) -> bool:
    """Write a bag in which the topics of each side have its name as a prefix.

    All sides start at the same time: the header stamps and the bag times of the others are shifted
    to the start of the first.
    """
    starts = {name: _start(messages) for name, messages in sides.items()}
    begin = next((start for start in starts.values() if start is not None), 0)
    together: list[tuple[int, Message]] = []
    for name, messages in sides.items():
        start = starts[name]
        shift = 0 if start is None else begin - start
        moved = [_moved(message, name, shift) for message in messages]
        # On a side without any stamp all messages get the start time.
        together += timed(moved, begin if start is None else 0)
    if not together:
        return False
    together.sort(key=lambda item: item[0])
    text = {key: v if isinstance(v, str) else json.dumps(v) for key, v in notes.items()}
    with writing(path):
        bag = TrialBag(path)
        try:
            bag.write(together, text)
            bag.finish(text)
        except BaseException:
            bag.discard()
            raise
    return True


def _start(messages: list[Message]) -> int | None:
    """Return the time [ns] at which an evaluation starts: its earliest stamp."""
    return min((t for message in messages if (t := stamp(message)) is not None), default=None)


def _moved(message: Message, side: str, shift: int) -> Message:
    topic, data = message
    time_then = stamp(message)
    if time_then is not None and shift:
        changed = bytearray(data)
        _STAMP.pack_into(changed, _ENCODING, *divmod(time_then + shift, NANOSECONDS))
        data = bytes(changed)
    return replace(topic, name=f"/{side}{topic.name}"), data
