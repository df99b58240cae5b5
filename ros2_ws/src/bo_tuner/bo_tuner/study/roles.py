"""Which running node is the plant, by what it publishes and hears."""

from collections.abc import Iterable, Sequence

from bo_tuner.study.offers import kinds_of
from bo_tuner.study.parameter_kinds import Kind
from bo_tuner.study.seen import SeenNode, SeenTopic
from bo_tuner.study.signal_offers import is_command


def is_plant(node: SeenNode, topics: Iterable[SeenTopic]) -> bool:
    """Whether a node looks like the plant of a controller, whether that is seen or not.

    It hears a command and publishes what is measured, commands nobody itself, and has a property of
    a plant, such as an inertia or a noise.
    """
    return Kind.PLANT in kinds_of(node).values() and _is_moved(node, list(topics))


def is_commanded(node: SeenNode, topics: Iterable[SeenTopic]) -> bool:
    """Whether a node could be a plant by its topics: of others it hears nothing but commands."""
    topics = list(topics)
    heard = [topic for topic in topics if node.name in topic.listeners and topic.publishers]
    return bool(heard) and all(map(is_command, heard)) and _is_moved(node, topics)


def _is_moved(node: SeenNode, topics: Sequence[SeenTopic]) -> bool:
    published = [topic for topic in topics if node.name in topic.publishers]
    heard = [topic for topic in topics if node.name in topic.listeners]
    commands = any(map(is_command, published))
    return bool(published) and not commands and any(map(is_command, heard))
