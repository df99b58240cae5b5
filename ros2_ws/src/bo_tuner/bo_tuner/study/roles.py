"""Which running node is the plant, by what it publishes and hears."""

from collections.abc import Iterable

from bo_tuner.study.offers import kinds_of
from bo_tuner.study.parameter_kinds import Kind
from bo_tuner.study.seen import SeenNode, SeenTopic
from bo_tuner.study.signal_offers import is_command


def is_plant(node: SeenNode, topics: Iterable[SeenTopic]) -> bool:
    """Whether a node looks like the plant of a controller, whether that is seen or not.

    It hears a command and publishes what is measured, commands nobody itself, and has a property of
    a plant, such as an inertia or a noise.
    """
    topics = list(topics)
    published = [topic for topic in topics if node.name in topic.publishers]
    heard = [topic for topic in topics if node.name in topic.listeners]
    return (
        Kind.PLANT in kinds_of(node).values()
        and bool(published)
        and not any(map(is_command, published))
        and any(map(is_command, heard))
    )
