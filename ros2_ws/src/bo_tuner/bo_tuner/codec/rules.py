"""What an annotation says of a value beside its type.

``Annotated[float, Within(above=0.0)]`` is read by its rule: any function that returns the checked
value, or raises a `StudyError`. A rule that an editor can know has its words of JSON Schema.
"""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError

Schema = dict[str, Any]


@dataclass(frozen=True)
class Within:
    """A number in an interval, whose ends belong to it (`least`, `most`) or not."""

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None
    unit: str = ""

    def __call__(self, value: object, *path: str | int) -> float:
        """Return the number as a float."""
        number = checks.number(value, *path)
        if (
            (self.above is None or number > self.above)
            and (self.least is None or number >= self.least)
            and (self.most is None or number <= self.most)
            and (self.below is None or number < self.below)
        ):
            return number
        raise StudyError(f"expected {self}, found {checks.show(value)}", path)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.above is not None and self.below is not None:
            return f"a number between {self.above:g} and {self.below:g}{unit}, both excluded"
        if self.least is not None and self.most is not None:
            return f"{self.least:g} to {self.most:g}{unit}"
        above = [f"a number above {self.above:g}"] if self.above is not None else []
        least = [f"at least {self.least:g}{unit}"] if self.least is not None else []
        most = [f"at most {self.most:g}{unit}"] if self.most is not None else []
        return " and ".join([*above, *least, *most])

    @property
    def schema(self) -> Schema:
        """Its words of JSON Schema."""
        words = {
            "exclusiveMinimum": self.above,
            "minimum": self.least,
            "maximum": self.most,
            "exclusiveMaximum": self.below,
        }
        return {word: end for word, end in words.items() if end is not None}


POSITIVE = Within(above=0.0)
SECONDS = Within(above=0.0, most=maxima.TIMEOUT, unit="s")
"""A time that an evaluation may take."""
DELAY = Within(least=0.0, most=maxima.TIMEOUT, unit="s")
FRACTION = Within(above=0.0, below=1.0)


@dataclass(frozen=True)
class Whole:
    """An integer in a range."""

    least: int
    most: int = checks.INTEGER_LIMIT

    def __call__(self, value: object, *path: str | int) -> int:
        """Return the integer."""
        return checks.integer(value, *path, at_least=self.least, at_most=self.most)

    @property
    def schema(self) -> Schema:
        """Its words of JSON Schema."""
        limited = self.most < checks.INTEGER_LIMIT
        return {"minimum": self.least, **({"maximum": self.most} if limited else {})}


Count = Annotated[int, Whole(0)]


@dataclass(frozen=True, eq=False)
class OneOf:
    """One of several words, which others may add to."""

    words: Collection[str]

    def __call__(self, value: object, *path: str | int) -> str:
        """Return the word."""
        return checks.choice(value, [*self.words], *path)

    @property
    def schema(self) -> Schema:
        """Its words of JSON Schema."""
        return {"enum": list(self.words)}


@dataclass(frozen=True)
class Matching:
    """A text that matches a pattern, which `expected` describes."""

    pattern: re.Pattern[str]
    expected: str

    def __call__(self, value: object, *path: str | int) -> str:
        """Return the text."""
        return checks.matching(value, self.pattern, self.expected, *path)


@dataclass(frozen=True)
class AtMost:
    """A list or mapping with a largest number of entries."""

    most: int

    def __call__(self, value: Collection[Any], *path: str | int) -> Collection[Any]:
        """Return it."""
        checks.at_most(value, self.most, *path)
        return value

    @property
    def schema(self) -> Schema:
        """Its words of JSON Schema, of which either one is looked at."""
        return {"maxItems": self.most, "maxProperties": self.most}


@dataclass(frozen=True)
class Expected:
    """What is said to be expected where a value has not the type."""

    words: str


@dataclass(frozen=True)
class Chosen:
    """One of several classes; a function says which one the keys of a mapping are of."""

    kind: Callable[[object], type[Any]]


@dataclass(frozen=True)
class Beside:
    """An object of one of several kinds, whose keys stand beside that of the kind."""

    kinds: Callable[[], Mapping[str, type[Any]]]


@dataclass(frozen=True)
class Null:
    """The number that null stands for in JSON, which has no word for one that is not finite."""

    number: float


@dataclass(frozen=True)
class Alone:
    """What may stand in a file in place of the mapping of a class.

    Attributes
    ----------
    kind
        Its type.
    fields
        The mapping that it is short for; None for nothing at all.
    expected
        What is said to be expected of anything else.
    """

    kind: Any
    fields: Callable[[Any], Mapping[str, object] | None]
    expected: str


@dataclass(frozen=True)
class Written:
    """What a file may have in place of a value; it is written out ahead of all checks."""

    kind: Any


def _names(values: Mapping[str, Any]) -> Mapping[str, Any]:
    for name in values:
        checks.name_in_node(name)
    return values


RosValue = Annotated[
    checks.ParameterValue,
    Expected("a number, text, true, false or a list of these"),
    checks.parameter_value,
]
"""What a ROS parameter can hold."""
RosValues = Annotated[
    Mapping[str, RosValue], Expected("parameters by name"), AtMost(maxima.CONSTANTS), _names
]

LATER = object()
"""Marks a field that the class checks itself."""
KEY = object()
"""Marks the field that has the name of an entry, which stands in a file ahead of its mapping."""
