"""What running nodes offer to a first study: parameters to tune, and contexts."""

import contextlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study.descriptors import Described
from bo_tuner.study.distributions import Uniform
from bo_tuner.study.nodes import USE_SIM_TIME
from bo_tuner.study.parameter import Parameter, study_name
from bo_tuner.study.parameter_kinds import Kind, kinds
from bo_tuner.study.parameter_scale import LOG, SYMLOG
from bo_tuner.study.seen import SeenNode
from bo_tuner.study.units import unit_in
from bo_tuner.text import one_line

OF_EVERY_NODE = (USE_SIM_TIME, "start_type_description_service")
"""Parameters that say how a node talks, not what it does; so do those below `qos_overrides`."""
MOST_SUGGESTED = 8
"""Parameters that are suggested; each one more asks for some twenty trials."""
MOST_ITEMS = 12
"""Largest array that has its items offered; longer ones are images, scans, covariances."""
COVARIANCE = re.compile(r"covariance|(^|[_.])cov([_.]|$)", re.IGNORECASE)
"""Name of an array that may be a covariance matrix, row by row."""
SEED = re.compile(r"(^|[_.])seed$", re.IGNORECASE)
"""Name of a parameter that seeds noise."""
DECADES = 100.0
"""Ratio of positive bounds from which on the scale is logarithmic."""
FAR_BELOW = 20.0
"""Ratio of upper bound to value from which on a range from 0 is nearly all far from the value."""
VARIATION = 0.2
"""Share by which a property of a plant is guessed to vary in operation."""
REFERENCE = re.compile(
    r"set_?point|reference|target|desired|wanted|demand|goal|command|trajectory"
    r"|(^|[/_])(ref|cmd|sp)([/_]|$)",
    re.IGNORECASE,
)
"""Words in the name of a topic, or a parameter, that carries what another signal shall follow."""
CHECK = "CHECK"
"""Marks a guess."""


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
    kind
        What it is by its name.
    suggested
        Whether it may be taken unless the user says otherwise.
    """

    node: str
    name: str
    fields: Mapping[str, Any] = field(hash=False)
    remark: str
    kind: Kind
    suggested: bool

    def __str__(self) -> str:
        return f"{self.node}:{self.name}"


@dataclass(frozen=True)
class ContextOffer:
    """A property of a plant that may vary: its name, its entry without the node, and a remark."""

    name: str
    fields: Mapping[str, Any] = field(hash=False)
    remark: str


def parameter_offers(node: SeenNode) -> tuple[list[ParameterOffer], dict[str, str]]:
    """Return the parameters of a node that could be tuned, and why the others could not, by name.

    Suggested are real numbers, and integers if the node gives their range, unless their name is
    that of a seed, of a property of the plant, or of a set-point, limit, period or the like. Any
    other integer may be a port or a count, and a truth value or a text a choice of the user's.
    """
    offers: list[ParameterOffer] = []
    others: dict[str, str] = {}
    kind_of = kinds_of(node)
    for name, described in node.parameters.items():
        if name in OF_EVERY_NODE or name.startswith("qos_overrides."):
            continue
        if name in node.changing:
            others[name] = "the node changes it by itself"
        elif described.read_only and not node.command:
            others[name] = "read-only"
        elif described.type in ("double", "integer", "boolean"):
            try:
                offers.append(_offer(node.name, name, described, kind_of[name]))
            except StudyError as error:
                others[name] = error.problem
        elif described.type == "double_array" and isinstance(described.value, (list, tuple)):
            if len(described.value) > MOST_ITEMS and not diagonal(name, described.value):
                others[name] = f"an array of {len(described.value)}; write its items as {name}[0]"
            offers += _items(node.name, name, described, kind_of[name])
        elif described.type == "string":
            others[name] = "a text; write choices: [...] to tune it"
        else:
            others[name] = described.type.replace("_", " ") or "not set"
    return offers, others


def reference_offers(node: SeenNode) -> Iterator[tuple[str, float]]:
    """Yield the parameters of a node that are its reference by their names, with values now."""
    for name, described in node.parameters.items():
        value = described.value
        is_free = not described.read_only and name not in node.changing
        if is_free and REFERENCE.search(name) and isinstance(value, float) and math.isfinite(value):
            yield name, value


def context_offers(node: SeenNode) -> list[ContextOffer]:
    """Return the parameters of a node that are properties of a plant by their names.

    Their bounds are a guess around the present value, within the range of the node.
    """
    kind_of = kinds_of(node)
    offers = []
    for name, described in node.parameters.items():
        is_free = not described.read_only and name not in node.changing
        if kind_of[name] is Kind.PLANT and described.type == "double" and is_free:
            with contextlib.suppress(StudyError):
                offers.append(_context(name, described))
    return offers


def suggested_parameters(offers: Iterable[ParameterOffer]) -> list[ParameterOffer]:
    """Return the parameters that are taken unless the user says otherwise.

    These are the ones with names of tuning parameters; if there is none, those with names that are
    of no known kind.
    """
    possible = [offer for offer in offers if offer.suggested]
    of_tuning = [offer for offer in possible if offer.kind is Kind.TUNING]
    return (of_tuning or possible)[:MOST_SUGGESTED]


def suggested_nodes(offers: Mapping[str, Sequence[ParameterOffer]]) -> list[str]:
    """Return the nodes that are tuned unless the user says otherwise, from the `offers` by node.

    These have a parameter with the name of a tuning parameter, such as controllers and estimators;
    if there is none, all nodes that have a suggested parameter.
    """
    possible = {node: [o for o in own if o.suggested] for node, own in offers.items()}
    of_tuning = [node for node, own in possible.items() if any(o.kind is Kind.TUNING for o in own)]
    return of_tuning or [node for node, own in possible.items() if own]


def kinds_of(node: SeenNode) -> dict[str, Kind]:
    """Return what each parameter of a node is by its name."""
    descriptions = {name: item.description for name, item in node.parameters.items()}
    return kinds(node.name, descriptions, is_estimator=node.is_estimator)


def _context(name: str, described: Described) -> ContextOffer:
    value = described.value
    if not isinstance(value, float) or not math.isfinite(value):
        raise StudyError(f"its value is {value}")
    if value != 0.0:
        ends = sorted(float(f"{value * share:.3g}") for share in (1 - VARIATION, 1 + VARIATION))
        remark = f"a guess, {VARIATION:.0%} around its value"
    else:
        ends = [described.lower, described.upper] if described.has_range else [0.0, 0.1]
        remark = "range of the node" if described.has_range else "a guess; it is 0 now"
    bounds = [min(max(end, described.lower), described.upper) for end in ends]
    nominal = float(f"{value:.6g}")
    Uniform(bounds=(bounds[0], bounds[1]), nominal=nominal)
    fields = {"distribution": Uniform.kind, "bounds": bounds, "nominal": nominal}
    return ContextOffer(
        name, fields | _unit(described), _described(f"{CHECK}: {remark}", described)
    )


def _unit(described: Described) -> dict[str, str]:
    unit = unit_in(described.description)
    return {"unit": unit} if unit else {}


def _described(remark: str, described: Described) -> str:
    """Add what the node says of a parameter."""
    description = one_line(described.description)
    return "; ".join(text for text in (remark, description) if text)


def _offer(node: str, name: str, described: Described, kind: Kind) -> ParameterOffer:
    fields: dict[str, Any] = {"type": described.type}
    remark, has_range = "", described.has_range and described.type != "boolean"
    number = int if described.type == "integer" else float
    if has_range:
        lower, upper = number(described.lower), number(described.upper)
        fields |= {"bounds": [lower, upper], "default": described.value}
        if described.has_steps:
            fields["step"] = number(described.step)
        if lower > 0 and upper >= DECADES * lower:
            fields["scale"] = LOG
        elif lower == 0 and _is_far_below(upper, described.value):
            fields["scale"] = SYMLOG
        remark = "range of the node"
    elif described.type == "boolean":
        fields["default"] = described.value
    else:
        fields |= _guessed(described.value)
        ends = (min(max(end, described.lower), described.upper) for end in fields["bounds"])
        fields["bounds"] = [number(end) for end in ends]
        if described.has_steps and math.isfinite(described.lower):
            fields["step"] = number(described.step)
            low = math.ceil((fields["bounds"][0] - described.lower) / described.step - 1e-9)
            fields["bounds"][0] = number(described.lower + low * described.step)
            if not fields["bounds"][0] > 0:
                fields.pop("scale", None)
        limits = [
            f"{word} {end:g}"
            for word, end in (("from", described.lower), ("to", described.upper))
            if math.isfinite(end)
        ]
        known = f"no range but {limits[0]}" if limits else "no range"
        remark = f"{CHECK}: a guess; the node gives {known}"
    fields |= _unit(described)
    # Raises if a study would refuse the parameter: then it is not offered.
    Parameter(name=study_name(name), parameter=name, node=node, **fields)
    suggested = described.type == "double" or has_range
    suggested &= kind in (Kind.TUNING, Kind.UNKNOWN)
    remark = _described(_by_name(kind, remark), described)
    if is_seed(name, described):
        remark, suggested = "by its name a seed of noise: seed_parameter takes it", False
    return ParameterOffer(node, name, fields, remark, kind, suggested)


def _is_far_below(upper: float, value: object) -> bool:
    """Whether nearly all of a range from 0 on is far from a value.

    A value of 0, such as that of a gain that is switched off, has no ratio to the upper bound. A
    range to 1 is then taken for that of a share, any other one for wide.
    """
    if not isinstance(value, (int, float)):
        return False
    return upper > 1.0 if value == 0.0 else 0.0 < value <= upper / FAR_BELOW


def _by_name(kind: Kind, remark: str) -> str:
    """Put the kind of a parameter that is hardly one to tune ahead of a remark."""
    if kind in (Kind.TUNING, Kind.UNKNOWN):
        return remark
    by_name = f"by its name {kind.value}"
    return f"{by_name}; {remark}" if remark else by_name


def is_seed(name: str, described: Described) -> bool:
    """Whether a parameter may seed the noise of a node."""
    return described.type == "integer" and SEED.search(name) is not None


def _items(node: str, name: str, array: Described, kind: Kind) -> Iterator[ParameterOffer]:
    values = array.value if isinstance(array.value, (list, tuple)) else ()
    variances = diagonal(name, values)
    for index in variances or range(min(len(values), MOST_ITEMS)):
        value, item = values[index], f"{name}[{index}]"
        try:
            fields = {"type": "double", **_guessed(value), **_unit(array)}
            Parameter(name=study_name(item), parameter=item, node=node, **fields)
        except StudyError:
            continue
        remark = _by_name(kind, f"{CHECK}: a guess; an array has no range")
        is_variance = index in variances and value > 0.0 and kind is Kind.TUNING
        yield ParameterOffer(node, item, fields, remark, kind, suggested=is_variance)


def diagonal(name: str, values: Sequence[object]) -> range:
    """Return the places of the variances in an array that is a covariance; none if it is not.

    By its name it is one, and as a matrix it has nothing beside its diagonal.
    """
    rows = math.isqrt(len(values))
    places = range(0, len(values), rows + 1)
    is_matrix = rows > 1 and rows * rows == len(values)
    if not is_matrix or not COVARIANCE.search(name):
        return range(0)
    return range(0) if any(v for i, v in enumerate(values) if i not in places) else places


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
    return {"bounds": bounds, "default": value} | ({"scale": LOG} if value > 0 else {})


def _signed(value: float, low: Any, high: Any) -> list[Any]:
    return [low, high] if value > 0 else [-high, -low]
