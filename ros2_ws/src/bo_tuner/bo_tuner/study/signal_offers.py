"""What running nodes offer to a first study: signals, and which of them follows which.

Which topic carries the reference, and which number follows it, can only be guessed by names and by
who listens to what; a study says so beside the guess.
"""

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from bo_tuner.study.offers import CHECK, REFERENCE
from bo_tuner.study.seen import SeenTopic

MOST_SIGNALS = 6
"""Signals that are suggested."""
MOST_OF_TOPIC = 3
"""Numbers of a message that are suggested if none has one of the names in `USUAL`."""
TRUTH = re.compile(r"ground_?truth|(^|[/_])(truth|gt)([/_]|$)", re.IGNORECASE)
"""Words in the name of a topic that carries what an estimator should find."""
USUAL = (
    re.compile(r"position\["),
    re.compile(r"velocity\["),
    re.compile(r"(^|\.)(linear\.x|angular\.z)$"),
    re.compile(r"(^|\.)(position\.[xyz]|angular_velocity\.[xyz])$"),
)
"""Fields of large messages that a controller controls, the most useful first."""
UNUSUAL = re.compile(r"(^|[._])(min|max|increment|time|seq|id|status|variance|w)([._]|$)")
"""Fields that say how something is measured or for how long it is valid, not what is measured."""
NO_SUBJECT = {
    *("data", "x", "y", "z", "w", "position", "velocity", "effort", "linear", "angular", "pose"),
    *("point", "points", "positions", "vector", "twist", "state", "states", "joint", "cmd", "ref"),
    *("ground", "truth", "groundtruth", "gt"),
}
"""Words in the name of a signal that do not say what it is a signal of."""
QUANTITIES = (
    ("velocity", re.compile(r"veloc|speed|twist|(^|[/_])(cmd_)?vel([/_:]|$)|rpm", re.IGNORECASE)),
    (
        "effort",
        re.compile(
            r"torque|effort|force|voltage|(motor|phase)_current|(^|[/_])current:", re.IGNORECASE
        ),
    ),
    ("temperature", re.compile(r"temp(erature)?([/_:]|$)", re.IGNORECASE)),
    ("position", re.compile(r"position|angle|pose|joint", re.IGNORECASE)),
)


@dataclass(frozen=True)
class SignalOffer:
    """A field of a topic that could be a signal."""

    topic: SeenTopic
    field: str

    def __str__(self) -> str:
        return f"{self.topic.name}:{self.field}"

    @property
    def remark(self) -> str:
        """Who publishes it."""
        if not self.topic.publishers:
            return "nobody publishes it, so the run will"
        names = " and ".join(self.topic.nodes)
        several = f"; {CHECK}: publisher names the one that counts, merge: true takes all"
        mixed = several if len(self.topic.nodes) > 1 else ""
        now = "; silent now" if self.topic.is_silent else ""
        return f"from {names}{mixed}{now}" + ("" if self.is_finite else "; not finite now")

    @property
    def value(self) -> float:
        """Its present value; 0 where no message was heard."""
        return float(self.topic.fields[self.field])

    @property
    def is_finite(self) -> bool:
        """Whether its present value is finite; a run with a value that is not fails."""
        return math.isfinite(self.value)

    @property
    def joint(self) -> str:
        """The joint of a part of a trajectory; empty for anything else."""
        fields = list(self.topic.fields)
        return self.topic.joints[fields.index(self.field)] if self.topic.joints else ""

    @property
    def quantity(self) -> str:
        """What it is by its name, such as a velocity; empty if the name does not say it."""
        return quantity_of(str(self))


def quantity_of(name: str) -> str:
    """Return what is measured by the name of a topic or signal; empty if the name does not say."""
    return next((quantity for quantity, pattern in QUANTITIES if pattern.search(name)), "")


def signal_offers(topic: SeenTopic) -> list[SignalOffer]:
    """Return the signals that a topic could give."""
    return [SignalOffer(topic, name) for name in topic.fields]


def suggested_signals(topics: Iterable[SeenTopic], nodes: Collection[str]) -> list[SignalOffer]:
    """Return the signals that are taken unless the user says otherwise, the most useful first.

    These are the reference and what follows it, where names say which, and what the tuned nodes
    publish and hear from others, each from one node: plain numbers before parts of larger
    messages. If that gives none, all topics are considered.

    Parameters
    ----------
    topics
        All topics.
    nodes
        Names of the nodes that are tuned.
    """
    topics = list(topics)
    single = [topic for topic in topics if len(topic.nodes) == 1]
    near = [topic for topic in single if {*topic.publishers, *topic.listeners} & set(nodes)]
    # A silent topic may be published in runs only, or never.
    pools = ([t for t in near if not t.is_silent], [t for t in single if not t.is_silent], near)
    usual = next((offers for pool in pools if (offers := [o for t in pool for o in _usual(t)])), [])
    heard = [t for t in topics if set(t.listeners) & set(nodes) and REFERENCE.search(t.name)]
    truths = [topic for topic in single if TRUTH.search(topic.name)]
    own = [topic for topic in single if set(topic.publishers) & set(nodes)]
    wanted = reference([o for topic in (*heard, *truths, *own) for o in _usual(topic)], nodes)
    measured = None
    if wanted is not None:
        possible = [offer for topic in single for offer in signal_offers(topic)]
        measured = partner(wanted, [o for o in possible if not UNUSUAL.search(o.field)], nodes)
    if wanted is not None and (measured is None or not is_sure(wanted, measured)):
        # Without a signal that surely follows it, a step of the reference is not suggested.
        wanted = measured = None
    first = [offer for offer in (wanted, measured) if offer is not None]
    outputs = [offer for offer in usual if set(offer.topic.publishers) & set(nodes)]
    usual.sort(key=lambda offer: (offer not in outputs[:1], len(offer.topic.fields) > 1))
    # One number of the reference is enough: a run moves one.
    rest = [o for o in usual if o not in first and (wanted is None or o.topic != wanted.topic)]
    return [*first, *rest][:MOST_SIGNALS]


def reference(offers: Sequence[SignalOffer], nodes: Collection[str]) -> SignalOffer | None:
    """Return the signal that others shall follow by the name of its topic, if any.

    Parameters
    ----------
    offers
        Signals to choose of.
    nodes
        Names of the nodes that are tuned; their own topics are no reference. If these are no
        commands, the nodes estimate something, and its ground truth is the reference.
    """
    own = {offer.topic for offer in offers if set(offer.topic.publishers) & set(nodes)}
    if own and not any(map(is_command, own)):
        truths = (o for o in offers if o.topic not in own and o.topic.publishers)
        if (truth := next((o for o in truths if is_truth(o)), None)) is not None:
            return truth
    possible = [
        offer
        for offer in offers
        if REFERENCE.search(offer.topic.name)
        and len(offer.topic.nodes) <= 1
        and not set(offer.topic.publishers) & set(nodes)
    ]
    # A topic that nobody publishes comes first: the run can publish it.
    rank = {
        offer: (bool(offer.topic.publishers), not set(offer.topic.listeners) & set(nodes))
        for offer in possible
    }
    return min(possible, key=lambda offer: rank[offer], default=None)


def partner(
    wanted: SignalOffer, offers: Iterable[SignalOffer], nodes: Collection[str]
) -> SignalOffer | None:
    """Return the signal that probably follows a reference, if there is any.

    Parameters
    ----------
    wanted
        The reference.
    offers
        Signals to choose of.
    nodes
        Names of the nodes that are tuned; their own outputs come last, beside a ground truth first.
    """

    def rank(offer: SignalOffer) -> tuple[bool, ...]:
        shared = set(wanted.topic.listeners) & set(offer.topic.listeners)
        return (
            not _is_same(wanted, offer),
            not _subject(wanted) & _subject(offer),
            offer.quantity != (wanted.quantity or "position"),
            bool(set(offer.topic.publishers) & set(nodes)) != is_truth(wanted),
            not shared,
            offer.topic.is_silent,
        )

    possible = [o for o in offers if o.topic != wanted.topic and o.topic.publishers and o.is_finite]
    return min(possible, key=rank, default=None)


def is_command(topic: SeenTopic) -> bool:
    """Whether a topic tells somebody what to do, by its name."""
    return REFERENCE.search(topic.name) is not None or quantity_of(topic.name) == "effort"


def is_truth(offer: SignalOffer) -> bool:
    """Whether a signal is what an estimator should find, by the name of its topic."""
    return TRUTH.search(offer.topic.name) is not None


def is_sure(wanted: SignalOffer, measured: SignalOffer) -> bool:
    """Whether names say that one signal follows another, and not only that nothing else could."""
    subject = _subject(wanted)
    if _is_same(wanted, measured) or subject & _subject(measured):
        return True
    if wanted.quantity or subject:
        return bool(wanted.quantity) and wanted.quantity == measured.quantity
    # A plain "setpoint" is of a position, or of the plain number that its listener measures.
    shared = set(wanted.topic.listeners) & set(measured.topic.listeners)
    is_plain = len(measured.topic.fields) == 1 and measured.quantity not in ("velocity", "effort")
    return measured.quantity == "position" or (bool(shared) and is_plain)


def _is_same(wanted: SignalOffer, offer: SignalOffer) -> bool:
    """Whether a signal is the same part of another message, or the joint of a trajectory."""
    if wanted.joint:
        return offer.field == f"position[{wanted.joint}]"
    tail = wanted.field.split(".")[-2:]
    return len(tail) > 1 and offer.field.split(".")[-2:] == tail


def _subject(offer: SignalOffer) -> set[str]:
    """Return the words in the name of a topic, without those that say that it is a reference."""
    last = offer.topic.name.rpartition("/")[2]
    text = f"{REFERENCE.sub('_', last)}_{offer.field}".lower()
    return set(re.findall(r"[a-z]+", text)) - NO_SUBJECT


def _usual(topic: SeenTopic) -> list[SignalOffer]:
    """Return the signals of a topic that are worth recording, unless the user says otherwise."""
    offers = [offer for offer in signal_offers(topic) if offer.is_finite]
    if len(topic.fields) == 1:
        return offers
    for pattern in USUAL:
        if matching := [offer for offer in offers if pattern.search(offer.field)]:
            return matching
    # Integers and truth values beside other fields are counters or states.
    numbers = [o for o in offers if type(topic.fields[o.field]) is float]
    return [o for o in numbers if not UNUSUAL.search(o.field)][:MOST_OF_TOPIC]
