"""A survey of the running graph: what could be tuned, and what could be a signal."""

import contextlib
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.fields import ItemMissingError, field_reader
from bo_tuner.backends.ros.graph import DISCOVERY, describe, values_now
from bo_tuner.backends.ros.messages import (
    interface_class,
    is_bulky,
    number_arrays,
    number_fields,
    type_name,
)
from bo_tuner.backends.ros.others import OF_ROS, is_hidden, relative
from bo_tuner.backends.ros.tuner_node import TunerNode, full_name, is_own
from bo_tuner.codec.checks import same_value
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.fields import parsed_field
from bo_tuner.study.seen import (
    JOINT_TRAJECTORY,
    Seen,
    SeenAction,
    SeenNode,
    SeenTopic,
    with_joints,
)

QUIET = 1.0
"""Time [s] without anything new after which the graph counts as complete."""
LISTEN = 1.0
"""Time [s] to hear a message, which has the items of arrays."""
CHANGES = 2.0
"""Time [s] in which parameters that a node changes by itself are seen to change."""
EVENTS = "/parameter_events"
"""Topic that every node with parameters publishes."""
PREFIX = 12
"""Bytes of the identifier of a topic's end that are its participant's (DDSI-RTPS 2.5, 9.3.1)."""
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What rmw calls the node of a topic's end while the node is not discovered."""
GOAL_SERVICE, GOAL_TYPE = "/_action/send_goal", "_SendGoal"
"""Ends of the name and the type of the service that takes the goals of an action."""
WITHOUT_REQUEST = ("std_srvs/srv/Empty", "std_srvs/srv/Trigger")


def survey(
    tuner: TunerNode, is_whole: Callable[[Seen], bool], named: Sequence[str] = ()
) -> tuple[Seen, list[str]]:
    """Look at all that runs."""
    fields: dict[str, list[str]] = {}
    for name in named:
        topic, has_field, path = name.partition(":")
        if has_field:
            fields.setdefault(topic, []).append(path)
    deadline = time.monotonic() + DISCOVERY
    while True:
        _settle(tuner)
        seen, notes = _look(tuner, fields)
        if is_whole(seen) or time.monotonic() > deadline:
            return seen, notes


def _look(tuner: TunerNode, named: Mapping[str, Sequence[str]]) -> tuple[Seen, list[str]]:
    names = _nodes(tuner)
    if not names:
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        raise BackendError(
            f"no node with parameters found in {DISCOVERY:g} s in domain {domain}, namespace "
            f"{tuner.node.get_namespace()}; start your nodes first"
        )
    nodes, notes = [], []
    for name in names:
        try:
            nodes.append(SeenNode(name, describe(tuner, name)))
        except BackendError as error:
            notes.append(f"left out: {error}")
    values, looked = [_values(tuner, node) for node in nodes], time.monotonic()
    topics, unknown = _topics(tuner, named)
    tuner.spin_for(CHANGES - (time.monotonic() - looked))
    nodes = [
        replace(node, changing=_changed(before, _values(tuner, node)))
        for node, before in zip(nodes, values, strict=True)
    ]
    topics = [with_joints(topic, nodes, topics) for topic in topics]
    unknown += [f"{topic.name}: its joints are unknown" for topic in topics if not topic.fields]
    topics = [topic for topic in topics if topic.fields]
    notes += [f"left out: {text}" for text in unknown]
    typed = sorted(tuner.node.get_service_names_and_types())
    services = [n for n, types in typed if types[0] in WITHOUT_REQUEST and not is_hidden(n)]
    together = tuple(_together(tuner, {node.name for node in nodes}))
    return Seen(
        tuple(nodes), tuple(topics), tuple(services), tuple(_actions(typed)), together
    ), notes


def _together(tuner: TunerNode, names: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield the nodes of each process that has several: they share a participant of DDS."""
    processes: dict[bytes, set[str]] = {}
    for end in tuner.node.get_publishers_info_by_topic(EVENTS):
        name = relative(tuner.node, end.node_name, end.node_namespace)
        if name in names:
            processes.setdefault(bytes(end.endpoint_gid)[:PREFIX], set()).add(name)
    yield from sorted(tuple(sorted(own)) for own in processes.values() if len(own) > 1)


def _values(tuner: TunerNode, node: SeenNode) -> Mapping[str, object]:
    """Read the parameters of a node; none if it has ended, which the next command reports."""
    try:
        return values_now(tuner, node.name, list(node.parameters))
    except BackendError:
        return {}


def _changed(before: Mapping[str, object], now: Mapping[str, object]) -> tuple[str, ...]:
    return tuple(
        name for name, value in before.items() if name in now and not same_value(now[name], value)
    )


def _actions(services: Iterable[tuple[str, list[str]]]) -> Iterator[SeenAction]:
    """Yield the actions whose types are installed here, by the services that they are."""
    for name, (kind, *_) in services:
        action = name.removesuffix(GOAL_SERVICE)
        if action == name or is_hidden(action):
            continue
        kind = kind.removesuffix(GOAL_TYPE)
        with contextlib.suppress(StudyError):
            fields = interface_class(kind).Goal.get_fields_and_field_types()
            yield SeenAction(action, kind, fields)


def _settle(tuner: TunerNode) -> None:
    """Wait until nothing new has been found for a while."""
    seen: tuple[object, ...] = ()
    since = time.monotonic()

    def is_quiet() -> bool:
        nonlocal seen, since
        node = tuner.node
        now = (
            sorted(node.get_node_names_and_namespaces()),
            sorted(name for name, _ in node.get_topic_names_and_types()),
            sorted(name for name, _ in node.get_service_names_and_types()),
        )
        if now != seen:
            seen, since = now, time.monotonic()
        is_still = bool(_nodes(tuner)) and time.monotonic() - since > QUIET
        return is_still and _has_all_nodes(tuner.node)

    tuner.wait_until(is_quiet, DISCOVERY)


def _has_all_nodes(node: Node) -> bool:
    """Whether each topic and service belongs to a node that is seen, with its parameters.

    On a busy computer the ends of topics are there well before the nodes that have them.
    """
    topics = [name for name, _ in node.get_topic_names_and_types() if name not in OF_ROS]
    services = {name for name, _ in node.get_service_names_and_types()}
    ends = [
        end.node_name
        for topic in topics
        for find in (node.get_publishers_info_by_topic, node.get_subscriptions_info_by_topic)
        for end in find(topic)
    ]
    owned: set[str] = set()
    for name, namespace in node.get_node_names_and_namespaces():
        try:
            found = node.get_service_names_and_types_by_node(name, namespace)
        except RuntimeError:
            # It is leaving.
            continue
        own = {service for service, _ in found}
        asked = f"{full_name(namespace, name)}/get_parameters"
        if own and asked not in own and not is_own(name):
            return False
        owned |= own
    return UNKNOWN_NODE not in ends and services <= owned


def _nodes(tuner: TunerNode) -> list[str]:
    """Return the names of the nodes with parameters, relative to the namespace."""
    services = {name for name, _ in tuner.node.get_service_names_and_types()}
    names = {
        relative(tuner.node, name, namespace)
        for name, namespace in tuner.node.get_node_names_and_namespaces()
        if f"{full_name(namespace, name)}/get_parameters" in services
    }
    return sorted(name for name in names if name and not is_hidden(name))


def _topics(
    tuner: TunerNode, named: Mapping[str, Sequence[str]]
) -> tuple[list[SeenTopic], list[str]]:
    """Return the topics with numbers, or with what is `named`, and why others are left out."""
    topics, notes = [], []
    heard: dict[str, bytes] = {}
    listened = {}
    classes = {}
    bulky = []
    for name, types in sorted(tuner.node.get_topic_names_and_types()):
        if name in OF_ROS or is_hidden(name):
            continue
        first = tuner.node.get_publishers_info_by_topic(name)[:1]
        try:
            classes[name] = interface_class(first[0].topic_type if first else types[0])
        except StudyError as error:
            notes.append(f"{name}: {error.problem}")
            continue
        if is_bulky(classes[name]):
            # To send an image or a point cloud costs a system that is at work.
            bulky.append(name)
            continue
        for publisher in first:
            latched = publisher.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
            # A publisher waits for no reader who only tries; what is latched comes in no other way.
            qos = QoSProfile(
                depth=1,
                reliability=(
                    publisher.qos_profile.reliability
                    if latched
                    else QoSReliabilityPolicy.BEST_EFFORT
                ),
                durability=publisher.qos_profile.durability,
            )
            listened[name] = tuner.node.create_subscription(
                classes[name], name, _keep(heard, name), qos, raw=True
            )
    tuner.wait_until(lambda: len(heard) == len(listened), LISTEN)
    for subscription in listened.values():
        tuner.node.destroy_subscription(subscription)
    for name, cls in classes.items():
        try:
            message = decode(heard[name], cls) if name in heard else cls()
        except UnreadableError as error:
            notes.append(f"{name} {error}")
            continue
        publishers = _ends(tuner, tuner.node.get_publishers_info_by_topic(name))
        listeners = _ends(tuner, tuner.node.get_subscriptions_info_by_topic(name))
        # Of a covariance an item is recorded where it is named.
        fields = {k: v for k, v in number_fields(message).items() if "covariance" not in k}
        for path in named.get(name, ()):
            if path not in fields:
                fields |= _named(name, path, message, heard=name in heard, silent=not publishers)
        is_trajectory = type_name(cls) == JOINT_TRAJECTORY and listeners and not publishers
        if fields or is_trajectory:
            topic = SeenTopic(name, type_name(cls), fields, publishers, listeners)
            topics.append(replace(topic, is_silent=bool(publishers) and name not in heard))
        elif name in listened and name not in heard:
            notes.append(f"{name}: silent for {LISTEN:g} s, so the items of its arrays are unknown")
        elif (arrays := number_arrays(cls)) and name not in bulky:
            why = (
                "long arrays" if name in heard else "nobody publishes it, and its arrays are empty"
            )
            item, least = f"{name}:{arrays[0]}[0]", f"{name}:min({arrays[0]})"
            notes.append(
                f"{name}: {why}; to record an item, or a number of all, name it: --signals "
                f"{item}, or '{least}'"
            )
    if bulky:
        notes.append(
            f"items of {', '.join(bulky)}: raw bytes, as of an image, which were not listened to"
        )
    return topics, notes


def _named(
    topic: str, path: str, message: Any, *, heard: bool, silent: bool
) -> dict[str, bool | int | float]:
    """Return a number that is named, by its field.

    Of an array that a run is to publish it comes with all items before it.
    """
    try:
        parsed = parsed_field(path)
        return {path: field_reader(type(message), parsed)(message)}
    except StudyError as error:
        raise StudyError(f"--signals: {topic}:{path}: {error.problem}") from None
    except ItemMissingError as error:
        if heard:
            raise StudyError(f"--signals: {topic}:{path}: a message {error}") from None
    item = parsed[-1].item if isinstance(parsed, tuple) else None
    if silent and isinstance(item, int):
        array = path.removesuffix(f"[{item}]")
        return {f"{array}[{index}]": 0.0 for index in range(item + 1)}
    return {path: 0.0}


def _ends(tuner: TunerNode, endpoints: Sequence[TopicEndpointInfo]) -> tuple[str, ...]:
    """Return the names of the nodes at one end of a topic, one for each publisher or listener."""
    return tuple(
        sorted(
            # One of another namespace may have the name of a node in this one.
            relative(tuner.node, end.node_name, end.node_namespace)
            or full_name(end.node_namespace, end.node_name)
            for end in endpoints
        )
    )


def _keep(heard: dict[str, bytes], name: str) -> Callable[[bytes], None]:
    def keep(message: bytes) -> None:
        heard[name] = message

    return keep
