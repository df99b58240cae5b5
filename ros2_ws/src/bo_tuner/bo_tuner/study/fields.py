"""What a signal takes from a message: a field, or a number that is computed from fields.

A field is a path such as ``pose.pose.position.x``. A call such as ``min(finite(ranges), 10)`` makes
one number of arrays; its grammar is

.. code-block:: text

    field    = path | angle "(" path ")" | "len" "(" argument ")" | reduction "(" arguments ")"
    argument = path | number | filter "(" argument ")" | angle ... | len ... | reduction ...

with the names of `bo_tuner.numerics.reductions`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.reductions import ANGLES, FILTERS, REDUCTIONS

LEN = "len"
"""Function that counts the items of an array."""
FUNCTIONS = (*REDUCTIONS, LEN, *ANGLES, *FILTERS)
LONGEST = 500
"""Characters of a field."""
FIELD_PART = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?", re.ASCII)
SLICE = re.compile(r"(\d*):(\d*)", re.ASCII)
CALL = re.compile(r"([A-Za-z]\w*)\s*\((.*)\)", re.ASCII | re.DOTALL)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
EXAMPLES = (
    "data, pose.pose.position.x, data[3] or position[motor], or a number of fields such as "
    "min(ranges), norm(twist.twist.linear) or len(poses)"
)


@dataclass(frozen=True)
class FieldPart:
    """A step into a message: the field `name`, and of an array the item `item`, if any.

    An item is a number, or a name that is looked up in the array `name` beside the field, such as
    that of a joint in a `sensor_msgs/msg/JointState`; within a call also a slice. Without an item
    the part is the field itself, which within a call may be a whole array.
    """

    name: str
    item: int | str | slice | None = None


@dataclass(frozen=True)
class FieldCall:
    """A function of fields and numbers."""

    function: str
    arguments: "tuple[Argument, ...]"


FieldPath = tuple[FieldPart, ...]
Argument = FieldPath | FieldCall | float
Field = FieldPath | FieldCall


def parsed_field(text: str) -> Field:
    """Parse the field, or the call, that a signal takes from a message.

    Raises
    ------
    StudyError
        If the text is neither.
    """
    if len(text) > LONGEST:
        raise StudyError(f"expected at most {LONGEST} characters", ("field",))
    parsed = _parsed(text.strip(), text)
    if isinstance(parsed, float):
        raise StudyError(f"expected a field, found {checks.show(text)}", ("field",))
    if isinstance(parsed, FieldCall) and parsed.function in FILTERS:
        raise StudyError(
            f"{parsed.function} leaves an array; expected one number of it, such as min({text})",
            ("field",),
        )
    if isinstance(parsed, tuple) and any(isinstance(part.item, slice) for part in parsed):
        raise StudyError(
            f"several items are no number; expected one of them, such as min({text})", ("field",)
        )
    return parsed


def field_path(text: str) -> FieldPath:
    """Split the path of a field, such as ``pose.pose.position.x`` or ``position[motor]``.

    Raises
    ------
    StudyError
        If it is none.
    """
    return _path(text, text)


def paths(field: Argument) -> Iterator[FieldPath]:
    """Yield the paths in a field."""
    if isinstance(field, tuple):
        yield field
    elif isinstance(field, FieldCall):
        for argument in field.arguments:
            yield from paths(argument)


def has_names(field: Field) -> bool:
    """Whether it has an item that is given by a name."""
    return any(isinstance(part.item, str) for path in paths(field) for part in path)


def _parsed(text: str, whole: str) -> Argument:
    if NUMBER.fullmatch(text):
        return float(text)
    if (call := CALL.fullmatch(text)) is None:
        return _path(text, whole)
    name, inner = call.groups()
    if name not in FUNCTIONS:
        raise StudyError(
            f"there is no function '{name}' of fields; {checks.suggestion(name, FUNCTIONS)}",
            ("field",),
        )
    arguments = tuple(_parsed(part.strip(), whole) for part in _split(inner, whole))
    is_single = name in (LEN, *ANGLES, *FILTERS)
    if is_single and len(arguments) != 1:
        raise StudyError(f"{name} takes 1 argument, found {len(arguments)}", ("field",))
    if not any(True for argument in arguments for _ in paths(argument)):
        raise StudyError(f"{name} needs a field, found {checks.show(inner.strip())}", ("field",))
    if name in ANGLES and not isinstance(arguments[0], tuple):
        raise StudyError(
            f"{name} is of a quaternion; expected a field such as {name}(pose.pose.orientation)",
            ("field",),
        )
    return FieldCall(name, arguments)


def _split(text: str, whole: str) -> list[str]:
    """Split arguments at the commas outside of inner brackets."""
    arguments, depth, in_item, begin = [], 0, False, 0
    for place, letter in enumerate(text):
        # Within [ ], the name of an item may have any character but the closing bracket.
        if in_item or letter == "[":
            in_item = letter != "]"
        elif letter in "()":
            depth += 1 if letter == "(" else -1
            if depth < 0:
                raise _no_field(whole)
        elif letter == "," and depth == 0:
            arguments.append(text[begin:place])
            begin = place + 1
    if depth != 0 or in_item:
        raise _no_field(whole)
    return [*arguments, text[begin:]]


def _path(text: str, whole: str) -> FieldPath:
    parts = []
    for part in re.split(r"\.(?![^\[]*\])", text):
        match = FIELD_PART.fullmatch(part)
        if match is None:
            raise _no_field(whole)
        parts.append(FieldPart(match[1], _item(match[2])))
    return tuple(parts)


def _item(text: str | None) -> int | str | slice | None:
    if text is None:
        return None
    if text.isascii() and text.isdigit():
        return int(text)
    if ends := SLICE.fullmatch(text):
        return slice(*(int(end) if end else None for end in ends.groups()))
    return text


def _no_field(text: str) -> StudyError:
    return StudyError(f"expected a field such as {EXAMPLES}, found {checks.show(text)}", ("field",))
