"""What a study records of a system's topics, and expressions of it."""

import keyword
import re
from collections.abc import Iterable
from dataclasses import dataclass

from bo_tuner.errors import StudyError
from bo_tuner.numerics.expressions import (
    FUNCTIONS,
    Expression,
    ExpressionError,
    UnknownNameError,
)
from bo_tuner.study import checks

HEADER, RECEPTION = "header", "reception"
TIME = "t"
"""Name, in an expression, of the time since the start of the run [s]."""

SIGNAL_NAME = re.compile(r"[A-Za-z_]\w{0,63}", re.ASCII)
GRAPH_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
FIELD_PART = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)
MESSAGE_TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)


@dataclass(frozen=True)
class FieldPart:
    """A step into a message: the field `name`, and of an array the item `item`, if any.

    An item is a number, or a name that stands in the array `name` beside the field, as that of a
    joint in a `sensor_msgs/msg/JointState`.
    """

    name: str
    item: int | str | None = None


def field_path(text: str) -> tuple[FieldPart, ...]:
    """Split the path of a field, such as ``pose.pose.position.x`` or ``position[motor]``.

    Raises
    ------
    StudyError
        If it is none.
    """
    parts = []
    for part in re.split(r"\.(?![^\[]*\])", text):
        match = FIELD_PART.fullmatch(part)
        if match is None:
            raise StudyError(
                f"expected a field such as data, pose.pose.position.x, data[3] or "
                f"position[motor], found {checks.show(text)}",
                ("field",),
            )
        item = match[2]
        is_number = item is not None and item.isascii() and item.isdigit()
        parts.append(FieldPart(match[1], int(item) if is_number else item))
    return tuple(parts)


@dataclass(frozen=True, kw_only=True)
class Signal:
    """A number in the messages of a topic, over the time of a run.

    Attributes
    ----------
    name : str
        Name in the study and in expressions.
    topic : str
        The topic, relative to the tuner's namespace or absolute.
    field : str
        Path of the field, such as `data`, `pose.pose.position.x`, `data[3]`, or `position[motor]`
        for the joint `motor` of a JointState.
    type : str
        Type of the messages, such as `std_msgs/msg/Float64`; what the publisher says unless given.
    time : str
        `header`, the stamp in the message's header, or `reception`, when it came in by the clock
        of the run; `header` if the message has one, unless given.
    minimum_messages : int
        A run with fewer messages fails.
    largest_gap : float, optional
        A run fails if no message comes for longer than this [s], also after its start or before
        its end; unless given, if none comes for much longer than in the first runs.
    most_lost : int, optional
        A run fails if more messages than this are lost or late.
    """

    name: str
    topic: str
    field: str
    type: str = ""
    time: str = ""
    minimum_messages: int = 1
    largest_gap: float | None = None
    most_lost: int | None = None

    def __post_init__(self) -> None:
        checks.matching(self.name, SIGNAL_NAME, "a name of letters, digits and _")
        if self.name == TIME or self.name in FUNCTIONS or keyword.iskeyword(self.name):
            raise StudyError(f"'{self.name}' has a meaning in expressions; choose another name")
        checks.matching(self.topic, GRAPH_NAME, "a topic name such as /joint_states", "topic")
        field_path(checks.text(self.field, "field"))
        if self.type != "":
            checks.matching(
                self.type, MESSAGE_TYPE, "a message type such as std_msgs/msg/Float64", "type"
            )
        if self.time != "":
            checks.choice(self.time, (HEADER, RECEPTION), "time")
        checks.integer(self.minimum_messages, "minimum_messages", at_least=0)
        if self.largest_gap is not None:
            gap = checks.positive(self.largest_gap, "largest_gap")
            object.__setattr__(self, "largest_gap", gap)
        if self.most_lost is not None:
            checks.integer(self.most_lost, "most_lost", at_least=0)


def expression(text: object, signals: Iterable[str], *path: str | int) -> Expression:
    """Return the expression that a text is.

    Raises
    ------
    StudyError
        If it is none, or has other names than signals and `TIME`.
    """
    return named_expression(text, (*signals, TIME), "signal", *path)


def named_expression(
    text: object, names: tuple[str, ...], kind: str, *path: str | int, finite: bool = False
) -> Expression:
    """Return the expression of names that a text is; `kind` says in errors what these are of.

    `finite` as in `Expression`.

    Raises
    ------
    StudyError
        If it is none, or has other names.
    """
    try:
        return Expression(checks.text(text, *path), names, finite=finite)
    except UnknownNameError as error:
        hint = checks.suggestion(error.name, error.known)
        raise StudyError(f"there is no {kind} or function '{error.name}'; {hint}", path) from None
    except ExpressionError as error:
        problem = f"{error}, in {checks.quoted(str(text))}"
        raise StudyError(problem, path) from None
