"""What running nodes hear of a bag, and what they answer: its beginning is played to them."""

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from rclpy.topic_endpoint_info import TopicEndpointInfo

from bo_tuner.backends.ros import others
from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.fields import field_reader
from bo_tuner.backends.ros.messages import interface_class, number_fields
from bo_tuner.backends.ros.own_topics import OwnTopic
from bo_tuner.backends.ros.play.bag import Bag
from bo_tuner.backends.ros.play.play_clock import PlayClock
from bo_tuner.backends.ros.play.player import Player
from bo_tuner.backends.ros.tuner_node import TunerNode, full_name
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.fields import parsed_field
from bo_tuner.study.first_estimator import POSES, HeardBag
from bo_tuner.study.playing import Play
from bo_tuner.study.seen import SeenNode, SeenTopic
from bo_tuner.text import listed

SECONDS = 10.0
"""Time [s] of a bag that is played."""
LONGEST = 120.0
"""Longest time [s] that this takes."""


def hear(tuner: TunerNode, play: Play, folder: Path, nodes: Iterable[SeenNode]) -> HeardBag:
    """Play the beginning of a bag, as seen from a folder, to running nodes.

    Raises
    ------
    StudyError
        If it cannot be played, or no node hears a topic of it.
    BackendError
        If a node does not follow.
    """
    bag = Bag(folder / play.bag)
    ends = _Ends(tuner, nodes)
    listeners = {
        name: ends.of(others.subscribers(tuner.node, play.remap.get(name, name)))
        for name in bag.types
    }
    if not any(listeners.values()):
        raise StudyError(_nothing_in_common(tuner, bag, ends))
    own: dict[str, OwnTopic] = {}
    clock = PlayClock(tuner, own, None)
    last = play.begin + SECONDS
    play = replace(play, end=last if play.end is None else min(play.end, last))
    try:
        player = Player(tuner, play, str(folder), {}, own, clock, None)
        try:
            return _play(tuner, player, clock, bag, ends, listeners)
        finally:
            player.close()
    except LostError as loss:
        raise BackendError(str(loss)) from loss
    finally:
        clock.end()
        for topic in own.values():
            tuner.node.destroy_publisher(topic.publisher)


class _Ends:
    """Names of nodes as a study has them, by the ends of topics."""

    def __init__(self, tuner: TunerNode, nodes: Iterable[SeenNode]) -> None:
        space = tuner.node.get_namespace()
        self._names = {full_name(space, node.name): node.name for node in nodes}

    def of(self, ends: Iterable[TopicEndpointInfo]) -> tuple[str, ...]:
        """Return the names of the nodes at ends, each once."""
        full = dict.fromkeys(full_name(end.node_namespace, end.node_name) for end in ends)
        return tuple(self._names[name] for name in full if name in self._names)


def _nothing_in_common(tuner: TunerNode, bag: Bag, ends: _Ends) -> str:
    heard = {
        f"{name} ({infos[0].topic_type})"
        for name in others.topics(tuner.node)
        if ends.of(infos := others.subscribers(tuner.node, name))
    }
    has = [f"{name} ({kind})" for name, kind in bag.types.items()]
    return (
        f"'{bag.path}': no node hears a topic of it: it has {listed(has)}, and heard are "
        f"{listed(sorted(heard)) or 'none'}; start the node with the names of the bag"
    )


def _play(
    tuner: TunerNode,
    player: Player,
    clock: PlayClock,
    bag: Bag,
    ends: _Ends,
    listeners: Mapping[str, tuple[str, ...]],
) -> HeardBag:
    publishers = {
        name: ends.of(others.publishers(tuner.node, name)) for name in others.topics(tuner.node)
    }
    hearing = {name for own in listeners.values() for name in own}
    outputs = [name for name, own in publishers.items() if hearing & {*own}]
    player.hear(outputs)
    clock.begin()
    player.begin()
    if not tuner.wait_until(lambda: player.is_over, LONGEST):
        raise BackendError(f"{bag.path}: the nodes took more than {LONGEST:g} s for its beginning")
    player.check()
    kinds = dict(tuner.node.get_topic_names_and_types())
    topics = [
        SeenTopic(name, kind, _numbers(kind, _first_message(bag, name)), (), listeners[name])
        for name, kind in bag.types.items()
    ]
    latest = player.latest
    published = [
        SeenTopic(
            name,
            kinds[name][0],
            _numbers(kinds[name][0], latest.get(name)),
            publishers[name],
            is_silent=name not in latest,
        )
        for name in outputs
    ]
    return HeardBag(tuple(topics), tuple(published), player.answers)


def _first_message(bag: Bag, topic: str) -> bytes | None:
    messages = bag.messages([topic], 0.0, None, {}, {})
    return next((message.data for message in messages), None)


def _numbers(kind: str, data: bytes | None) -> dict[str, bool | int | float]:
    """Return the numbers of a message, or of an empty one; none of a type that is not installed."""
    numbers: dict[str, bool | int | float] = {}
    with contextlib.suppress(StudyError, UnreadableError):
        cls = interface_class(kind)
        message = cls() if data is None else decode(data, cls)
        numbers = {k: v for k, v in number_fields(message).items() if "covariance" not in k}
        if (pose := POSES.get(kind)) and pose.covariance:
            variance = f"{pose.covariance}[0]"
            numbers[variance] = field_reader(cls, parsed_field(variance))(message)
    return numbers
