"""The latest messages of the signals, as they came: what is kept of a run that is aborted."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

KEPT = 5_000_000_000
"""Time [ns] for which a message is kept."""
MEMORY = 20_000_000
"""Most bytes that are kept."""


class LatestMessage(NamedTuple):
    """A message: when it came [ns], its topic and type, and itself as it is on the wire."""

    received: int
    topic: str
    type: str
    data: bytes


class LatestMessages:
    """Keeps the messages of the latest 5 s, and no more of them than 20 MB."""

    def __init__(self) -> None:
        self._kept: deque[LatestMessage] = deque()
        self._size = 0

    def add(self, message: LatestMessage) -> None:
        """Keep a message, and let those go that are too old, or too many."""
        self._kept.append(message)
        self._size += len(message.data)
        oldest = message.received - KEPT
        while self._kept and (self._kept[0].received < oldest or self._size > MEMORY):
            self._size -= len(self._kept.popleft().data)

    def now(self) -> Sequence[LatestMessage]:
        """Return what is kept, in the order of arrival."""
        return sorted(self._kept, key=lambda message: message.received)
