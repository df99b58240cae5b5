"""The abort condition of a run, seen by the guard's own subscriptions."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np
from rclpy.node import Node

from bo_tuner.backends.ros.conditions import known
from bo_tuner.backends.ros.fields import ItemMissingError
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.heard_topic import HeardTopic
from bo_tuner.backends.ros.messages import interface_class
from bo_tuner.backends.ros.publishers import Publishers, several_on
from bo_tuner.backends.ros.readers import FramesReader, Reader, TransformFeed, Value, reader_of
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.signals import STATIC, TIME, Signal, expression

SEARCH = 0.5
"""Time [s] between two searches for a topic that nobody publishes yet."""


@dataclass
class _Topic:
    heard: HeardTopic
    readers: dict[str, Reader] = field(default_factory=dict)


class AbortCondition:
    """Judges the abort condition on each message of its signals, as it comes in.

    A signal of which nothing was heard decides nothing, and is looked for again and again: its
    publisher may start only with a run.
    """

    def __init__(self, node: Node, plan: Plan) -> None:
        self._node = node
        signals = plan.signals or {}
        self._condition = expression(plan.abort_when, signals) if plan.abort_when else None
        names = () if self._condition is None else self._condition.names - {TIME}
        self._wanted = {name: signals[name] for name in names}
        self._topics: dict[str, _Topic] = {}
        self._feeds: dict[str, TransformFeed] = {}
        self._newest: dict[str, Value] = dict.fromkeys(self._wanted, np.nan)
        self._searched = -np.inf

    @property
    def missing(self) -> list[str]:
        """Names of the signals that nothing publishes, or that cannot be read."""
        heard = {name for topic in self._topics.values() for name in topic.readers}
        return sorted(self._wanted.keys() - heard)

    def holds(self, seconds: float) -> bool:
        """Whether it holds for what came in since this was last asked."""
        if self._condition is None:
            return False
        if self.missing and time.monotonic() - self._searched > SEARCH:
            self._searched = time.monotonic()
            self._subscribe()
        # In the order in which they came: else the newest value of one topic would be compared
        # with old ones of another.
        heard = [item for topic in self._topics.values() for item in _take(topic)]
        rows = [self._newest]
        for _, values in sorted(heard, key=itemgetter(0)):
            rows.append(rows[-1] | values)
        self._newest = rows[-1]
        # The latest values are judged once more: the condition may depend on time alone.
        arrays: dict[str, Array] = {
            name: np.array([row[name] for row in rows]) for name in self._wanted
        }
        with np.errstate(all="ignore"):
            return bool(known(np.atleast_1d(self._condition(arrays | {TIME: seconds}))).any())

    def _subscribe(self) -> None:
        for name in self.missing:
            spec = self._wanted[name]
            topic = self._node.resolve_topic_name(spec.topic)
            offered = Publishers(self._node, topic).own(spec)
            if not offered:
                continue
            try:
                self._read(name, spec, topic, interface_class(offered[0].topic_type))
            except StudyError:
                # The tuner refuses the study.
                continue

    def _read(self, name: str, spec: Signal, topic: str, cls: type) -> None:
        """Hear a signal from now on."""
        reader = reader_of(spec, cls, self._node, self._feeds)
        if isinstance(reader, FramesReader):
            self._hear(f"{topic}{STATIC}", cls).readers[name] = reader.still
        self._hear(topic, cls).readers[name] = reader

    def _hear(self, topic: str, cls: type) -> _Topic:
        if topic not in self._topics:
            # Whether publishers must be known is decided when a topic is first heard.
            several = several_on(self._node, topic, self._wanted.values())
            offered = Publishers(self._node, topic).now()
            heard = HeardTopic(self._node, topic, cls, offered, knows_publisher=several)
            self._topics[topic] = _Topic(heard)
        return self._topics[topic]


def _take(topic: _Topic) -> Iterator[tuple[int, dict[str, Value]]]:
    """Yield when [ns] what waits on a topic came, and its values by the names of signals."""
    for heard in topic.heard.take():
        values_of: dict[str, list[Value]] = {}
        for name, reader in topic.readers.items():
            # The tuner fails the run for what is missing.
            with contextlib.suppress(ItemMissingError):
                values_of[name] = [value for _, value in reader(heard)]
        for index in range(max(map(len, values_of.values()), default=0)):
            yield (
                heard.received,
                {name: values[index] for name, values in values_of.items() if index < len(values)},
            )
