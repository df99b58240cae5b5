"""Messages that were heard and wait to be taken away, within a bound of memory."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from bo_tuner.recording.bag import Message, Topic


@dataclass
class Batch:
    """Messages in the order of their arrival, and how many are missing.

    Attributes
    ----------
    messages
        The messages.
    size
        Of all of them [byte].
    dropped
        How many there was no memory for.
    lost
        How many the middleware has lost.
    """

    messages: list[Message] = field(default_factory=list)
    size: int = 0
    dropped: int = 0
    lost: int = 0


class Inbox:
    """Collects messages; whoever hands one in, from any thread, only ever appends to a list.

    Attributes
    ----------
    warnings
        What went wrong so far, each in a line.
    """

    def __init__(self, quiet: float, latest: float, memory: float = math.inf) -> None:
        self._quiet = quiet
        self._latest = latest
        self._memory = memory
        self._lock = threading.Lock()
        self._batch = Batch()
        self._waiting = 0
        self.warnings: list[str] = []

    def take(self, topic: Topic, data: bytes) -> None:
        """Take a message."""
        with self._lock:
            if self._waiting + len(data) > self._memory:
                self._batch.dropped += 1
                return
            self._waiting += len(data)
            self._batch.size += len(data)
            self._batch.messages.append((topic, data))

    def lose(self, count: int) -> None:
        """Take note of messages that were lost on the way."""
        with self._lock:
            self._batch.lost += count

    def warn(self, text: str) -> None:
        """Take note, once, of something that went wrong, or of a topic that cannot be heard."""
        with self._lock:
            if text not in self.warnings:
                self.warnings.append(text)

    def add(self, batch: Batch) -> None:
        """Take what another inbox has had."""
        for topic, data in batch.messages:
            self.take(topic, data)
        with self._lock:
            self._batch.dropped += batch.dropped
            self._batch.lost += batch.lost

    def empty(self) -> Batch:
        """Return what came since the last call; it takes up memory until `let_go` has it."""
        with self._lock:
            batch, self._batch = self._batch, Batch()
        return batch

    def let_go(self, batch: Batch) -> None:
        """Let new messages have the memory of a batch."""
        with self._lock:
            self._waiting -= batch.size

    def forget(self) -> None:
        """Let go of what came since the last call of `empty`."""
        self.let_go(self.empty())

    def wait_for_quiet(self, hand_over: Callable[[], object]) -> None:
        """Let the last messages of an evaluation come: topics have no order between them."""
        end = time.monotonic() + self._latest
        count = -1
        while count != len(self._batch.messages) and time.monotonic() < end:
            count = len(self._batch.messages)
            time.sleep(self._quiet)
            hand_over()

    def collect(self, hand_over: Callable[[], object]) -> Batch:
        """Wait for the last messages of an evaluation; returns all since the last call, let go."""
        self.wait_for_quiet(hand_over)
        batch = self.empty()
        self.let_go(batch)
        return batch
