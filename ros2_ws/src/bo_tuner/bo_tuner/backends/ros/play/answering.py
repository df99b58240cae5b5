"""Which messages of a bag are answered, and on which topics."""

from collections import Counter
from collections.abc import Mapping

from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.study.playing import Answer

ROUGHLY = 0.1
"""Share of the answers that may be missing, as of the first messages of a filter."""
LEAST = 3
"""Answers from which on they are no accident."""


def answers(sent: Mapping[str, int], answered: Mapping[tuple[str, str], int]) -> dict[str, Answer]:
    """Return on which topics messages are answered, each one or each k-th one.

    Parameters
    ----------
    sent
        Numbers of messages by their topics.
    answered
        Of how many of them, by their topic and another one, something came there meanwhile.
    """
    found: dict[str, Answer] = {}
    for (topic, other), count in Counter(answered).most_common():
        every = round(sent[topic] / count)
        due = sent[topic] / every
        if topic == CLOCK or topic in found or count < LEAST:
            continue
        if abs(count - due) <= ROUGHLY * due:
            found[topic] = Answer(topic=other, every=every)
    return found
