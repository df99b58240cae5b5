"""Who publishes a topic, and whether their messages would mix in a signal."""

import time
from collections.abc import Callable, Iterable, Sequence

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.guard.messages import GUARD
from bo_tuner.backends.ros.tuner_node import UNKNOWN_NODE, full_name
from bo_tuner.errors import StudyError
from bo_tuner.study.signals import Signal

NAME_TIMEOUT = 1.0
"""Time [s] that the graph has to show the node of a new publisher."""
QUERY = 0.1
"""Time [s] between two queries of the graph: one takes longer than a message."""


class Publishers:
    """The publishers of a topic, as the graph has them; a guard, which is silent, is none."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic
        self._queried = -QUERY
        self._endpoints: list[TopicEndpointInfo] = []
        self._names: dict[bytes, str] = {}

    def now(self) -> list[TopicEndpointInfo]:
        """Query the graph."""
        endpoints = self._node.get_publishers_info_by_topic(self._topic)
        self._queried = time.monotonic()
        self._endpoints = [info for info in endpoints if info.node_name != GUARD]
        for info in self._endpoints:
            if info.node_name != UNKNOWN_NODE:
                gid = bytes(info.endpoint_gid)
                self._names[gid] = full_name(info.node_namespace, info.node_name)
        return self._endpoints

    def lately(self) -> list[TopicEndpointInfo]:
        """Return the publishers of a recent query, or of a new one."""
        return self._endpoints if time.monotonic() - self._queried < QUERY else self.now()

    def name_of(self, gid: bytes) -> str:
        """Return the full name of the node of a publisher; empty if it is not known."""
        if gid and gid not in self._names:
            self.lately()
        return self._names.get(gid, "")

    def own(self, spec: Signal) -> list[TopicEndpointInfo]:
        """Return those, as of now, that a signal is of."""
        return self._own(spec, self.now())

    def has_own(self, spec: Signal) -> bool:
        """Whether one that a signal is of was there lately."""
        return bool(self._own(spec, self.lately()))

    def _own(
        self, spec: Signal, publishers: Sequence[TopicEndpointInfo]
    ) -> list[TopicEndpointInfo]:
        if not spec.publisher:
            return list(publishers)
        wanted = node_of(self._node, spec)
        return [i for i in publishers if full_name(i.node_namespace, i.node_name) == wanted]

    def mixed(self, spec: Signal) -> str:
        """Return a line if publishers of more than one node mix in a signal; empty if not.

        Those of one node belong together, and the study may say of which node, or that all do.
        """
        if spec.merge or spec.frames is not None:
            return ""
        own = self.own(spec)
        nodes = {(info.node_namespace, info.node_name) for info in own}
        running = self._node.get_node_names_and_namespaces()
        if len(own) > 1 and len(nodes) == 1:
            ((namespace, name),) = nodes
            if running.count((name, namespace)) <= 1 and name != UNKNOWN_NODE:
                return ""
        if len(own) <= 1:
            return ""
        of = f" in {spec.publisher}" if spec.publisher else ""
        return f"{self._topic} has {len(own)} publishers{of}"

    def names(self) -> str:
        """Return the names of the nodes, as far as they are known."""
        names = sorted(i.node_name for i in self.lately() if i.node_name != UNKNOWN_NODE)
        return " and ".join(names)


def node_of(node: Node, spec: Signal) -> str:
    """Return the full name of the node that a signal is of."""
    if spec.publisher.startswith("/"):
        return spec.publisher
    return full_name(node.get_namespace(), spec.publisher)


def several_on(node: Node, topic: str, signals: Iterable[Signal]) -> bool:
    """Whether one of some signals is of a topic that may have publishers of several nodes."""
    return any(
        spec.has_several and node.resolve_topic_name(spec.topic) == topic for spec in signals
    )


def expected_publishers(
    node: Node, topic: str, spec: Signal, wait: Callable[[Callable[[], bool]], bool]
) -> list[TopicEndpointInfo]:
    """Return the publishers that a signal is of, at least one."""
    publishers = Publishers(node, topic)
    if not wait(lambda: bool(publishers.now())):
        near = others.instead(topic, others.topics(node), node)
        raise StudyError(f"nothing publishes {topic}; {near}", ("topic",))
    if not wait(lambda: bool(publishers.own(spec))):
        raise StudyError(
            f"{node_of(node, spec)} does not publish {topic}; expected one of {publishers.names()}",
            ("publisher",),
        )
    # One that was only just found may not have its name yet.
    deadline = time.monotonic() + NAME_TIMEOUT

    def are_named() -> bool:
        named = all(info.node_name != UNKNOWN_NODE for info in publishers.now())
        return named or time.monotonic() > deadline

    wait(are_named)
    if mixed := publishers.mixed(spec):
        raise StudyError(
            f"{mixed} ({publishers.names()}), whose messages would mix; name one of them by "
            "publisher, or take all by merge: true",
            ("topic",),
        )
    return publishers.own(spec)
