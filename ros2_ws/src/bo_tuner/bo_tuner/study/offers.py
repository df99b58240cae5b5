"""What running nodes offer to a first study: parameters to tune, and signals to record."""

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study import maxima
from bo_tuner.study.descriptors import Described
from bo_tuner.study.nodes import USE_SIM_TIME
from bo_tuner.study.parameter import Parameter
from bo_tuner.text import one_line

OF_EVERY_NODE = (USE_SIM_TIME, "start_type_description_service")
"""Parameters that say how a node talks, not what it does; so do those below `qos_overrides`."""
MOST_SUGGESTED = 8
"""Parameters that are suggested; of more, those with a name that tells of tuning."""
TUNABLE = re.compile(
    r"(^|[_.])(k[pidfvas]?|[pid]|alpha|beta|gamma|lambda|tau)([_.]|$)"
    r"|gain|weight|penalt|noise|covariance|cut_?off|bandwidth|horizon|look_?ahead|time_constant",
    re.IGNORECASE,
)
"""In the name of a parameter: controllers and estimators are tuned by it."""
MOST_ITEMS = 12
"""Of an array whose items are offered; longer ones are images, scans, covariances."""
SEED = re.compile(r"(^|[_.])seed$", re.IGNORECASE)
"""Name of a parameter that seeds noise."""
DECADES = 100.0
"""Ratio of positive bounds from which the logarithm is searched."""
CHECK = "CHECK"
"""Marks a guess."""


@dataclass(frozen=True)
class SeenNode:
    """A node, by its name relative to the namespace, and what it says of its parameters."""

    name: str
    parameters: Mapping[str, Described]

    @property
    def uses_sim_time(self) -> bool:
        """Whether its time is that of ``/clock``."""
        return USE_SIM_TIME in self.parameters and self.parameters[USE_SIM_TIME].value is True


@dataclass(frozen=True)
class SeenTopic:
    """A topic with numbers.

    Attributes
    ----------
    name, type
        Of the topic, and of its messages.
    fields
        The numbers that can be signals: their value in a message that was heard, by field. Of a
        topic that was silent those that every message has, as in an empty one.
    publishers, listeners
        Names of nodes.
    """

    name: str
    type: str
    fields: Mapping[str, bool | int | float] = field(hash=False)
    publishers: tuple[str, ...] = ()
    listeners: tuple[str, ...] = ()


@dataclass(frozen=True)
class SeenAction:
    """An action: its name and type, and the types of a goal's fields by their names."""

    name: str
    type: str
    fields: Mapping[str, str] = field(hash=False)


@dataclass(frozen=True)
class Seen:
    """What runs: nodes with parameters, topics with numbers, services without request, actions."""

    nodes: tuple[SeenNode, ...]
    topics: tuple[SeenTopic, ...]
    services: tuple[str, ...] = ()
    actions: tuple[SeenAction, ...] = ()


@dataclass(frozen=True)
class ParameterOffer:
    """A parameter that could be tuned.

    Attributes
    ----------
    node
        Name of its node.
    name
        Its name in the node; an item of an array is ``weights[1]``.
    fields
        Its entry in a study, without the node.
    remark
        Where its bounds come from.
    suggested
        Whether it may be taken unless somebody says otherwise, see `suggested_parameters`.
    """

    node: str
    name: str
    fields: Mapping[str, Any] = field(hash=False)
    remark: str
    suggested: bool

    def __str__(self) -> str:
        return f"{self.node}:{self.name}"


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
        names = " and ".join(self.topic.publishers)
        mixed = ", which would mix" if len(self.topic.publishers) > 1 else ""
        return f"from {names}{mixed}" + ("" if self.is_finite else "; not finite now")

    @property
    def is_finite(self) -> bool:
        """Whether its present value is a number; a run with one that is none fails."""
        return math.isfinite(self.topic.fields[self.field])


def parameter_offers(node: SeenNode) -> tuple[list[ParameterOffer], dict[str, str]]:
    """Return the parameters of a node that could be tuned, and why the others could not, by name.

    Suggested are real numbers, and integers whose range the node gives, unless their name is that
    of a seed; any other integer may be a port or a count, and a truth value or a text a choice of
    the user's.
    """
    offers: list[ParameterOffer] = []
    others: dict[str, str] = {}
    for name, described in node.parameters.items():
        if name in OF_EVERY_NODE or name.startswith("qos_overrides."):
            continue
        if described.read_only:
            others[name] = "read-only"
        elif described.type in ("double", "integer", "boolean"):
            try:
                offers.append(_offer(node.name, name, described))
            except StudyError as error:
                others[name] = error.problem
        elif described.type == "double_array" and isinstance(described.value, (list, tuple)):
            if len(described.value) > MOST_ITEMS:
                others[name] = f"an array of {len(described.value)}; write its items as {name}[0]"
            offers += _items(node.name, name, described.value[:MOST_ITEMS])
        elif described.type == "string":
            others[name] = "a text; write choices: [...] to tune it"
        else:
            others[name] = described.type.replace("_", " ") or "not set"
    return offers, others


def suggested_parameters(offers: Iterable[ParameterOffer]) -> list[ParameterOffer]:
    """Return the parameters that are taken unless somebody says otherwise.

    Each one more asks for some twenty trials. Of many, only those are taken whose names tell of
    tuning, and not masses, limits and rates, which are numbers with a range as well.
    """
    possible = [offer for offer in offers if offer.suggested]
    if len(possible) <= MOST_SUGGESTED:
        return possible
    telling = [offer for offer in possible if TUNABLE.search(offer.name)]
    return (telling or possible)[:MOST_SUGGESTED]


def suggested_nodes(offers: Mapping[str, Sequence[ParameterOffer]]) -> list[str]:
    """Return the nodes that are tuned unless somebody says otherwise, of `offers` by node.

    These have a parameter whose name tells of tuning, as a controller or an estimator does: the
    mass or friction of a simulated plant is no choice. Without any such node all are.
    """
    possible = {node: [o for o in found if o.suggested] for node, found in offers.items()}
    telling = [n for n, found in possible.items() if any(TUNABLE.search(o.name) for o in found)]
    return telling or [node for node, found in possible.items() if found]


def suggested_signals(topics: Iterable[SeenTopic], nodes: Collection[str]) -> list[SignalOffer]:
    """Return the signals that are taken unless somebody says otherwise.

    These are what the tuned nodes publish and hear from others, each from one publisher; all topics
    if that is nothing.
    """
    single = [topic for topic in topics if len(topic.publishers) == 1]
    near = [topic for topic in single if {*topic.publishers, *topic.listeners} & set(nodes)]
    first, further = (
        [offer for topic in found for offer in signal_offers(topic) if offer.is_finite]
        for found in (near, single)
    )
    return (first or further)[: maxima.SIGNALS]


def signal_offers(topic: SeenTopic) -> list[SignalOffer]:
    """Return the signals that a topic could give."""
    return [SignalOffer(topic, name) for name in topic.fields]


def _offer(node: str, name: str, described: Described) -> ParameterOffer:
    fields: dict[str, Any] = {"type": described.type}
    remark, has_range = "", described.has_range and described.type != "boolean"
    kind = int if described.type == "integer" else float
    if has_range:
        lower, upper = kind(described.lower), kind(described.upper)
        fields |= {"bounds": [lower, upper], "default": described.value}
        if described.has_steps:
            fields["step"] = kind(described.step)
        if lower > 0 and upper >= DECADES * lower:
            fields["scale"] = "log"
        remark = "range of the node"
    elif described.type == "boolean":
        fields["default"] = described.value
    else:
        fields |= _guessed(described.value)
        ends = (min(max(end, described.lower), described.upper) for end in fields["bounds"])
        fields["bounds"] = [kind(end) for end in ends]
        if described.has_steps and math.isfinite(described.lower):
            fields["step"] = kind(described.step)
            low = math.ceil((fields["bounds"][0] - described.lower) / described.step - 1e-9)
            fields["bounds"][0] = kind(described.lower + low * described.step)
            if not fields["bounds"][0] > 0:
                fields.pop("scale", None)
        limits = [
            f"{word} {end:g}"
            for word, end in (("from", described.lower), ("to", described.upper))
            if math.isfinite(end)
        ]
        known = f"no range but {limits[0]}" if limits else "no range"
        remark = f"{CHECK}: a guess; the node gives {known}"
    if described.description:
        remark += f"{'; ' if remark else ''}{one_line(described.description)}"
    # Whatever a study would refuse is no offer.
    Parameter(name=name, node=node, **fields)
    suggested = described.type == "double" or has_range
    if is_seed(name, described):
        remark, suggested = "by its name a seed of noise: seed_parameter takes it", False
    return ParameterOffer(node, name, fields, remark, suggested)


def is_seed(name: str, described: Described) -> bool:
    """Whether a parameter may seed the noise of a node."""
    return described.type == "integer" and SEED.search(name) is not None


def _items(node: str, name: str, values: Sequence[object]) -> Iterator[ParameterOffer]:
    for index, value in enumerate(values):
        fields = {"type": "double", **_guessed(value)}
        item = f"{name}[{index}]"
        try:
            Parameter(name=item, node=node, **fields)
        except StudyError:
            continue
        remark = f"{CHECK}: a guess; an array has no range"
        yield ParameterOffer(node, item, fields, remark, suggested=False)


def _guessed(value: object) -> dict[str, Any]:
    """Guess bounds around a value: a tenth to ten times it, an integer a quarter to four times."""
    if isinstance(value, int):
        low, high = (1, 10) if value == 0 else (max(1, abs(value) // 4), 4 * abs(value))
        return {"bounds": [0, high] if value == 0 else _signed(value, low, high), "default": value}
    if not isinstance(value, float) or not math.isfinite(value):
        raise StudyError(f"its value is {value}")
    if value == 0.0:
        return {"bounds": [0.0, 1.0], "default": 0.0}
    bounds = [float(f"{end:.3g}") for end in _signed(value, abs(value) / 10, abs(value) * 10)]
    return {"bounds": bounds, "default": value} | ({"scale": "log"} if value > 0 else {})


def _signed(value: float, low: Any, high: Any) -> list[Any]:
    return [low, high] if value > 0 else [-high, -low]
