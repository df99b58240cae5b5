"""What nodes tell of their parameters by themselves: a value that they should not have."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from rcl_interfaces.msg import ParameterEvent
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import qos_profile_parameter_events

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.parameters.services import named_values
from bo_tuner.study.checks import same_value
from bo_tuner.text import brief

PARAMETER_EVENTS = "/parameter_events"
MOST_TOLD = 100
"""Sets of values told to a node whose events are awaited: it need not publish any."""


@dataclass(frozen=True)
class Difference:
    """A parameter of a node that has another value than it was given; None is not set."""

    node: str
    name: str
    found: object
    expected: object

    def __str__(self) -> str:
        found = "not set" if self.found is None else brief(str(self.found))
        return f"{self.node}: parameter {self.name} is {found}, expected {self.expected}"


def differences(
    node: str, found: Mapping[str, object], expected: Mapping[str, object]
) -> list[Difference]:
    """Compare what a node has with what it was given."""
    return [
        Difference(node, name, found.get(name), value)
        for name, value in expected.items()
        if not same_value(found.get(name), value)
    ]


class ParameterWatch:
    """Listens on ``/parameter_events`` for values that are not as expected.

    Parameters
    ----------
    node
        The tuner's node.
    nodes
        Names of the watched nodes, relative to its namespace, by their keys in the study.
    """

    def __init__(self, node: Node, nodes: Mapping[str, str]) -> None:
        self._keys: dict[str, list[str]] = {}
        for key, name in nodes.items():
            full_name = expand_topic_name(name, node.get_name(), node.get_namespace())
            self._keys.setdefault(full_name, []).append(key)
        self._expected: Mapping[str, Mapping[str, object]] = {}
        self._seen: list[Difference] = []
        self._declaring: set[str] = set()
        self._told: dict[str, deque[Mapping[str, object]]] = {
            key: deque(maxlen=MOST_TOLD) for key in nodes
        }
        self.problem = ""
        """What came since `expect` and cannot be read: it may tell of any parameter."""
        self._subscription = node.create_subscription(
            ParameterEvent,
            PARAMETER_EVENTS,
            self._on_event,
            qos_profile_parameter_events,
            raw=True,
        )

    def expect(self, expected: Mapping[str, Mapping[str, object]]) -> None:
        """Expect these values of the nodes from now on, by key, and nothing of before."""
        self.change(expected)
        self.problem = ""

    def change(self, expected: Mapping[str, Mapping[str, object]]) -> None:
        """Expect these values of the nodes from now on, by key, and others up to now."""
        self._take_all()
        self._expected = expected

    def tell(self, key: str, values: Mapping[str, object]) -> None:
        """Take note of what the tuner is about to set: its event is no change by others.

        As a rule a node publishes it ahead of its answer, but it may come long after that, when
        other values are expected.
        """
        self._told[key].append(values)

    def take_back(self, key: str) -> None:
        """Take back what was told last: the node has refused it, and publishes no event."""
        # Unless somebody else has set the same meanwhile.
        if self._told[key]:
            self._told[key].pop()

    def forget(self, key: str) -> None:
        """Forget what was seen of a node: it was started anew, and has declared its parameters.

        That it has may become known late. Its events arrive in their order, so until the first
        change all that it tells of new parameters is what it has declared.
        """
        self._take_all()
        self._seen = [difference for difference in self._seen if difference.node != key]
        self._declaring.add(key)
        self._told[key].clear()

    def take_seen(self) -> list[Difference]:
        """Return what was not as expected since this was last asked."""
        self._take_all()
        seen, self._seen = self._seen, []
        return seen

    def _take_all(self) -> None:
        """Take the events that wait."""
        with self._subscription.handle:
            while taken := self._subscription.handle.take_message(ParameterEvent, True):
                self._on_event(taken[0])

    def _on_event(self, data: bytes) -> None:
        try:
            event = decode(data, ParameterEvent)
        except UnreadableError as error:
            self.problem = f"a message on {PARAMETER_EVENTS} {error}"
            return
        for key in self._keys.get(event.node, ()):
            expected = self._expected.get(key, {})
            deleted = {p.name: None for p in event.deleted_parameters}
            now = named_values(event.changed_parameters) | deleted
            if now:
                self._declaring.discard(key)
            if key not in self._declaring:
                now = named_values(event.new_parameters) | now
            own = self._own(key, now)
            watched = {n: value for n, value in expected.items() if n in now and n not in own}
            self._seen += differences(key, now, watched)

    def _own(self, key: str, now: Mapping[str, object]) -> Mapping[str, object]:
        """Return what the tuner has told, if this is the event of it; it is no longer awaited."""
        told = self._told[key]
        for place, values in enumerate(told):
            if values.keys() <= now.keys() and not differences(key, now, values):
                # A node's events come in their order: those of what it was told before are lost.
                for _ in range(place + 1):
                    told.popleft()
                return values
        return {}
