"""Values that nodes have and should not: by their answers, and by their parameter events."""

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from rcl_interfaces.msg import ParameterEvent
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import qos_profile_parameter_events

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.errors import DisturbedError, RefusedError
from bo_tuner.backends.ros.parameters.messages import named_values
from bo_tuner.codec.checks import holds, same_value
from bo_tuner.text import brief

PARAMETER_EVENTS = "/parameter_events"
MOST_AWAITED = 100
"""Requests to a node whose events are awaited: it need not publish any."""


Values = Mapping[str, Mapping[str, object]]
"""Parameters by node key, then by name."""


@dataclass(frozen=True)
class Difference:
    """A parameter of a node that has another value than it was given; None is not set."""

    node: str
    name: str
    actual: object
    expected: object

    def __str__(self) -> str:
        actual = "not set" if self.actual is None else brief(str(self.actual))
        return f"{self.node}: parameter {self.name} is {actual}, expected {self.expected}"


def differences(
    node: str, actual: Mapping[str, object], expected: Mapping[str, object]
) -> list[Difference]:
    """Compare what a node has with what it was given."""
    return [
        Difference(node, name, actual.get(name), value)
        for name, value in expected.items()
        if not holds(actual.get(name), value)
    ]


def offer_unwatched(difference: Difference) -> str:
    """Return what leaves a parameter to its node, as it stands in a study."""
    return f"unwatched: [{difference.name}] in nodes.{difference.node}"


def not_taken(difference: Difference) -> RefusedError:
    """Make the error that a node has another value right after one was set."""
    return RefusedError(f"{difference} (not taken by the node)")


def disturbed(difference: Difference, own: Mapping[str, Collection[str]]) -> DisturbedError:
    """Make the error that somebody changed a parameter; `own` are those that are set, by node."""
    text = f"{difference} (changed by someone else)"
    if difference.name not in own.get(difference.node, ()):
        # Nobody sets it, so it may be the node itself.
        text += f"; if the node does that by itself: {offer_unwatched(difference)}"
    return DisturbedError(text)


@dataclass(frozen=True)
class Readback:
    """What nodes have, as read back from them, beside what they are to have.

    Attributes
    ----------
    held, values : Values
        What they are to have, and what they have.
    seen : sequence of Difference
        What else they were seen to have meanwhile.
    problem : str
        What cannot be read of the nodes' events.
    own : mapping
        By node key the names of the parameters that are set.
    """

    held: Values
    values: Values
    seen: Sequence[Difference]
    problem: str
    own: Mapping[str, Collection[str]]

    def check(self, assigned: Mapping[str, Collection[str]] | None = None) -> None:
        """Compare what the nodes had with what they are held at."""
        if self.problem:
            raise DisturbedError(self.problem)
        for key, values in self.held.items():
            for difference in differences(key, self.values[key], values):
                if difference.name in (assigned or {}).get(key, ()):
                    raise not_taken(difference)
                raise disturbed(difference, self.own)
        if self.seen:
            raise disturbed(self.seen[0], self.own)

    def rounded(self) -> Iterator[tuple[str, str, object]]:
        """Yield node key, name and value of what a node holds in fewer digits than were set."""
        for key, values in self.held.items():
            for name, value in values.items():
                actual = self.values[key].get(name)
                if holds(actual, value) and not same_value(actual, value):
                    yield key, name, actual


class ParameterWatch:
    """Listens on ``/parameter_events`` for values that are not as expected."""

    def __init__(self, node: Node, nodes: Mapping[str, str]) -> None:
        self._keys: dict[str, list[str]] = {}
        for key, name in nodes.items():
            full_name = expand_topic_name(name, node.get_name(), node.get_namespace())
            self._keys.setdefault(full_name, []).append(key)
        self._expected: Mapping[str, Mapping[str, object]] = {}
        self._seen: list[Difference] = []
        self._declaring: set[str] = set()
        self._awaited: dict[str, deque[Mapping[str, object]]] = {
            key: deque(maxlen=MOST_AWAITED) for key in nodes
        }
        self.problem = ""
        """An event since `expect` that cannot be read: it may be of any parameter."""
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

    def expect_event(self, key: str, values: Mapping[str, object]) -> None:
        """Take note of what the tuner is about to set: its event is no change by others.

        As a rule a node publishes it ahead of its answer, but it may come long after that, when
        other values are expected.
        """
        self._awaited[key].append(values)

    def take_back(self, key: str, values: Mapping[str, object]) -> None:
        """Expect no event of values after all: the node has refused them, and publishes none."""
        # Unless somebody else has set the same meanwhile.
        if values in self._awaited[key]:
            self._awaited[key].remove(values)

    def forget(self, key: str) -> None:
        """Forget what was seen of a node: it was started anew, and has declared its parameters.

        This may become known late. Its events arrive in their order, so all new parameters up to
        the first change are those that it has declared.
        """
        self._take_all()
        self._seen = [difference for difference in self._seen if difference.node != key]
        self._declaring.add(key)
        self._awaited[key].clear()

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
        """Return what the tuner has set, if this is its event; that is no longer awaited."""
        awaited = self._awaited[key]
        for place, values in enumerate(awaited):
            if values.keys() <= now.keys() and not differences(key, now, values):
                # A node's events come in their order: those of earlier requests are lost.
                for _ in range(place + 1):
                    awaited.popleft()
                return values
        return {}
