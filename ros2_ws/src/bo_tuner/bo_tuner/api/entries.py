"""The entries of a study as objects; `mapping` of each is what a study file has there."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bo_tuner.study.distributions import Distribution
from bo_tuner.trials import Value

When = str | Mapping[str, object]


@dataclass(frozen=True)
class Entry:
    """An entry of a study."""

    given: ClassVar[Mapping[str, str]] = {}

    @property
    def mapping(self) -> dict[str, object]:
        """What a study file has for it."""
        return {**self.given, **without_defaults(self)}


@dataclass(frozen=True)
class _Number(Entry):
    lower: float
    upper: float
    _: dataclasses.KW_ONLY
    default: float
    scale: str = "linear"
    step: float | None = None
    unit: str = ""
    prior: Mapping[str, float | str] | None = None
    when: When = ""

    @property
    def mapping(self) -> dict[str, object]:
        fields = super().mapping
        bounds = [fields.pop("lower"), fields.pop("upper")]
        return {**fields, "bounds": bounds}


@dataclass(frozen=True)
class Double(_Number):
    """A tuned number.

    Attributes
    ----------
    lower
        Smallest value.
    upper
        Largest value.
    default
        Hand-tuned value, with which all is compared.
    scale
        ``linear``, or ``log`` for a positive one whose ratios matter.
    step
        Only multiples of it above the lower bound are tried.
    unit
        Its unit, for displays only.
    prior
        Where the best value is believed to be, such as ``{"around": 2.0, "within": "1.5x"}``.
    when
        Condition under which there is this parameter, such as ``"horizon > 20"`` or
        ``{"planner": "mppi"}``; else a function is not given it.
    """

    given: ClassVar[Mapping[str, str]] = {"type": "double"}


@dataclass(frozen=True)
class Integer(_Number):
    """A tuned integer; attributes as of `Double`."""

    given: ClassVar[Mapping[str, str]] = {"type": "integer"}


@dataclass(frozen=True)
class Boolean(Entry):
    """A tuned truth value with its hand-tuned value; `when` as of `Double`."""

    default: bool
    _: dataclasses.KW_ONLY
    when: When = ""

    given: ClassVar[Mapping[str, str]] = {"type": "boolean"}


@dataclass(frozen=True)
class Choice(Entry):
    """One of several texts, numbers or lists, with the hand-tuned one.

    Attributes
    ----------
    choices
        The values.
    default
        Hand-tuned value, with which all is compared.
    ordered
        Whether they have the order in which they are listed; that of numbers unless given, and
        none of texts and lists.
    when
        As of `Double`.
    """

    choices: Sequence[Value | Sequence[Value]]
    _: dataclasses.KW_ONLY
    default: Value | Sequence[Value]
    ordered: bool | None = None
    when: When = ""

    @property
    def mapping(self) -> dict[str, object]:
        """What a study file has for it: of the type that all values have."""
        values: list[Any] = [plain(value) for value in (*self.choices, self.default)]
        suffix = "_array" if all(isinstance(value, list) for value in values) else ""
        if suffix:
            values = [item for value in values for item in value]
        kinds = {str: "string", int: "integer", bool: "boolean"}
        kind = next((kinds[k] for k in kinds if all(type(v) is k for v in values)), "double")
        return {"type": kind + suffix, **super().mapping}


@dataclass(frozen=True)
class Chance(Entry):
    """A limit that a run keeps with at least a probability, over contexts and noise.

    Attributes
    ----------
    metric
        What is limited.
    upper
        Largest permitted value. Text such as ``1.1 * default`` is relative to what the default has
        in the same context.
    lower
        Smallest permitted value, likewise; at least one of both.
    probability
        Between 0 and 1.
    """

    metric: str
    _: dataclasses.KW_ONLY
    probability: float
    upper: float | str | None = None
    lower: float | str | None = None

    given: ClassVar[Mapping[str, str]] = {"kind": "chance"}


@dataclass(frozen=True)
class WorstCase(Entry):
    """A limit that is kept in every context.

    Attributes
    ----------
    metric
        What is limited.
    upper
        Largest permitted value, or text such as ``1.1 * default``.
    lower
        Smallest permitted value; at least one of both.
    probability
        With which a run keeps it in each context; None: the mean over noise keeps it.
    """

    metric: str
    _: dataclasses.KW_ONLY
    upper: float | str | None = None
    lower: float | str | None = None
    probability: float | None = None

    given: ClassVar[Mapping[str, str]] = {"kind": "worst_case"}


def without_defaults(item: object) -> dict[str, object]:
    """Return the fields of a dataclass object that differ from their defaults."""
    return {
        field.name: getattr(item, field.name)
        for field in dataclasses.fields(item)  # type: ignore[arg-type]
        if getattr(item, field.name) != field.default
    }


def plain(value: object) -> object:
    """Return what a study file has for a value, or a part of a study, however it was given."""
    if isinstance(value, Entry):
        return plain(value.mapping)
    if isinstance(value, Distribution):
        return plain({"distribution": value.kind, **without_defaults(value)})
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain(without_defaults(value))
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value
