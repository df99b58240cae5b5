"""The abort condition of a run, seen by the guard's own subscriptions."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
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
        The guard's node, in whose executor the subscriptions are not served.
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
        found = False
        for topic in self._topics.values():
            heard = self._take(topic)
            count = max(map(len, heard.values()), default=0)
            if not count:
                continue
            self._newest |= {name: float(values[-1]) for name, values in heard.items()}
            values = {name: np.array(value) for name, value in self._newest.items()} | heard
            found |= self._judge(values, seconds)
        # Time alone may decide, too.
        return found or self._judge({n: np.array(v) for n, v in self._newest.items()}, seconds)

    def _judge(self, values: dict[str, Array], seconds: float) -> bool:
        if self._condition is None:
            return False
        with np.errstate(all="ignore"):
            return bool(known(np.atleast_1d(self._condition(values | {TIME: seconds}))).any())

    def _take(self, topic: _Topic) -> dict[str, Array]:
        """Return the values (n,) of what waits on a topic, by the names of its signals."""
        heard: dict[str, list[float]] = {name: [] for name in topic.read}
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
                for name, value in values.items():
                    heard[name].append(value)
        return {name: np.array(values) for name, values in heard.items() if values}

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
                offered = found[0].qos_profile
                qos = QoSProfile(
                    depth=DEPTH, reliability=offered.reliability, durability=offered.durability
                )
                subscription = self._node.create_subscription(
                    kind, topic, lambda message: None, qos, raw=True
                )
                self._topics[topic] = _Topic(subscription, kind)
            self._topics[topic].read[name] = read
