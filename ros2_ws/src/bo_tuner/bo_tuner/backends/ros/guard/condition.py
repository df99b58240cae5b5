"""The abort condition of a run, seen by the guard's own subscriptions."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.subscription import Subscription

from bo_tuner.backends.ros.conditions import known
from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.messages import ItemMissingError, interface_class, number_reader
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.signals import TIME, expression, field_path

DEPTH = 1000
"""Messages of a topic that may wait between two looks at it."""
LOOK = 0.5
"""Time [s] between two looks for a topic that nobody publishes yet."""


@dataclass
class _Topic:
    subscription: Subscription
    kind: Any
    read: dict[str, Any] = field(default_factory=dict)


class AbortCondition:
    """Judges the abort condition on each message of its signals, as it comes in.

    A signal of which nothing was heard decides nothing, and is looked for again and again: its
    publisher may start only with a run.

    Parameters
    ----------
    node
        Subscribes; it is not in an executor, which would take the messages away.
    plan
        What the guard holds.
    """

    def __init__(self, node: Node, plan: Plan) -> None:
        self._node = node
        signals = plan.signals or {}
        self._condition = expression(plan.abort_when, signals) if plan.abort_when else None
        names = () if self._condition is None else self._condition.names - {TIME}
        self._wanted = {name: signals[name] for name in names}
        self._topics: dict[str, _Topic] = {}
        self._newest: dict[str, float] = dict.fromkeys(self._wanted, np.nan)
        self._looked = -np.inf

    @property
    def missing(self) -> list[str]:
        """Names of the signals that nothing publishes, or that cannot be read."""
        heard = {name for topic in self._topics.values() for name in topic.read}
        return sorted(self._wanted.keys() - heard)

    def holds(self, seconds: float) -> bool:
        """Whether it holds for what came in since this was last asked.

        Parameters
        ----------
        seconds
            Time [s] since the start of the run.
        """
        if self._condition is None:
            return False
        if self.missing and time.monotonic() - self._looked > LOOK:
            self._looked = time.monotonic()
            self._subscribe()
        # In the order in which they came: else the newest of one topic would meet old ones of
        # another, and their difference be what it never was.
        heard = [item for topic in self._topics.values() for item in self._take(topic)]
        rows = [self._newest]
        for _, values in sorted(heard, key=itemgetter(0)):
            rows.append(rows[-1] | values)
        self._newest = rows[-1]
        # What came last is judged once more: time alone may decide, too.
        arrays: dict[str, Array] = {
            name: np.array([row[name] for row in rows]) for name in self._wanted
        }
        with np.errstate(all="ignore"):
            return bool(known(np.atleast_1d(self._condition(arrays | {TIME: seconds}))).any())

    def _take(self, topic: _Topic) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield when [ns] what waits on a topic came, and its values by the names of signals."""
        handle = topic.subscription.handle
        with handle:
            for _ in range(DEPTH):
                item = handle.take_message(topic.subscription.msg_type, True)
                if item is None:
                    break
                try:
                    message = decode(item[0], topic.kind)
                    values = {name: read(message) for name, read in topic.read.items()}
                except (UnreadableError, ItemMissingError):
                    # The tuner fails the run for that.
                    continue
                yield item[1]["received_timestamp"], values

    def _subscribe(self) -> None:
        for name in self.missing:
            spec = self._wanted[name]
            topic = self._node.resolve_topic_name(spec.topic)
            found = self._node.get_publishers_info_by_topic(topic)
            if not found:
                continue
            try:
                kind = interface_class(found[0].topic_type)
                read = number_reader(kind, field_path(spec.field))
            except StudyError:
                # The tuner refuses the study.
                continue
            if topic not in self._topics:
                qos = _hearing_all([info.qos_profile for info in found])
                subscription = self._node.create_subscription(
                    kind, topic, lambda message: None, qos, raw=True
                )
                self._topics[topic] = _Topic(subscription, kind)
            self._topics[topic].read[name] = read


def _hearing_all(offered: list[QoSProfile]) -> QoSProfile:
    """Return a profile that hears all publishers: what one does not offer is asked of none."""
    reliable = all(qos.reliability == QoSReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )
