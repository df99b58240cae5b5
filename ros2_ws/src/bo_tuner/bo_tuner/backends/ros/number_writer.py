"""Puts numbers into the fields of a message; arrays grow until they have the item."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rosidl_parser.definition import AbstractNestedType, NamespacedType

from bo_tuner.backends.ros.fields import field_reader
from bo_tuner.backends.ros.messages import FLOATS, field_types, integer_limits, interface_class
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.study.fields import FieldPart, FieldPath
from bo_tuner.text import brief

LARGEST_ARRAY = 1_000
"""Items to which an array grows that is given by the numbers in it."""


@dataclass(frozen=True)
class NumberWriter:
    """Puts numbers into one field of a message.

    Attributes
    ----------
    write : callable
        Puts one in; of an integer, the nearest one.
    limits : tuple of int, optional
        Lowest and highest number, if it is an integer.
    """

    write: Callable[[float], None]
    limits: tuple[int, int] | None = None


def number_writer(message: Any, path: FieldPath) -> NumberWriter:
    """Return what puts numbers into a field of a message; arrays grow until they have the item."""
    field_reader(type(message), path)
    holder = message
    for part in path[:-1]:
        place = None if part.item is None else _grown(holder, part)
        holder = getattr(holder, part.name)
        holder = holder if place is None else holder[place]
    part = path[-1]
    kind: Any = field_types(type(holder))[part.name]
    place = None
    if part.item is not None:
        place, kind = _grown(holder, part), kind.value_type
    if kind.typename == "boolean":
        raise StudyError(f"{part.name} is true or false; expected a number")
    is_float = kind.typename in FLOATS
    cast: Callable[[float], Any] = float if is_float else round

    def write(value: float) -> None:
        if place is None:
            setattr(holder, part.name, cast(value))
        else:
            getattr(holder, part.name)[place] = cast(value)

    return NumberWriter(write, None if is_float else integer_limits(kind.typename))


def _grown(holder: Any, part: FieldPart) -> int:
    """Return the position of an item in an array, which has it then."""
    items, kind = getattr(holder, part.name), field_types(type(holder))[part.name]
    if isinstance(part.item, str):
        if part.item not in holder.name:
            near = brief(checks.suggestion(part.item, holder.name))
            raise StudyError(f"has no '{part.item}' among its names; {near}")
        place = list(holder.name).index(part.item)
    else:
        place = part.item if isinstance(part.item, int) else 0
    most = getattr(kind, "maximum_size", LARGEST_ARRAY)
    if place >= most:
        raise StudyError(f"{part.name} has at most {most} items; none for [{place}]")
    value_type: Any = kind.value_type if isinstance(kind, AbstractNestedType) else None
    while len(items) <= place:
        if isinstance(value_type, NamespacedType):
            items.append(interface_class("/".join(value_type.namespaced_name()))())
        else:
            items.append(0.0 if value_type.typename in FLOATS else 0)
    return place
