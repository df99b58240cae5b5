"""Takes what a signal is of a message out of it: a field, or a number of several.

The way is looked up in the type of the messages once; a message then costs no more than its values.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractType,
    BasicType,
    NamespacedType,
)
from rosidl_parser.definition import Array as ArrayType

from bo_tuner.backends.ros.messages import OCTET, field_types, interface_class, type_name
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.reductions import ANGLES, FILTERS, REDUCTIONS, EmptyArrayError
from bo_tuner.study.fields import LEN, Argument, Field, FieldCall, FieldPart, FieldPath
from bo_tuner.text import brief

QUATERNION = "geometry_msgs/msg/Quaternion"
COMPONENTS = ("x", "y", "z", "w")


class ItemMissingError(Exception):
    """A message has not what a signal needs, such as the item of an array."""

    def __init__(self, problem: str, names: Sequence[str] = ()) -> None:
        super().__init__(problem)
        self.names = names


def field_reader(cls: Any, field: Field) -> Callable[[Any], float]:
    """Return a function that takes a number out of a message.

    It raises `ItemMissingError` for a message whose array does not have the item, or which has no
    such number, as the least of no values.
    """
    if isinstance(field, FieldCall):
        return _single(cls, field)
    _check_number(cls, field)

    def read(message: Any) -> float:
        return float(_followed(message, field))

    return read


def _check_number(cls: Any, path: FieldPath) -> None:
    """Refuse a path that does not lead to one number."""
    kind = kind_at(cls, path)
    shown = _shown(path)
    if isinstance(kind, NamespacedType):
        fields = ", ".join(field_types(_class_of(kind)))
        raise StudyError(f"{shown} is a {_name(kind)}; name one of its fields {fields}")
    if isinstance(kind, AbstractNestedType):
        by_name = f" or {shown}[NAME]" if "name" in field_types(_holder(cls, path)) else ""
        number = _is_number(kind.value_type)
        reduced = f", or a number of all such as min({shown})" if number else f", or len({shown})"
        raise StudyError(
            f"{shown} is an array; name one item, such as {shown}[0]{by_name}{reduced}"
        )
    if not _is_number(kind):
        raise StudyError(f"{shown} is text; expected a number")


def _single(cls: Any, call: FieldCall) -> Callable[[Any], float]:
    """Return a function that takes the number of a call out of a message."""
    if call.function in ANGLES:
        return _angle(cls, call)
    if call.function == LEN:
        return _length(cls, call)
    reduce = REDUCTIONS[call.function]
    parts = [_values(cls, argument, call) for argument in call.arguments]

    def read(message: Any) -> float:
        try:
            return reduce(np.concatenate([part(message) for part in parts]))
        except EmptyArrayError:
            raise ItemMissingError(
                f"has no values for {call.function}(...), which has none of an empty array"
            ) from None

    return read


def _angle(cls: Any, call: FieldCall) -> Callable[[Any], float]:
    (path,) = call.arguments
    kind = kind_at(cls, path)  # type: ignore[arg-type]
    shown = _shown(path)  # type: ignore[arg-type]
    if not isinstance(kind, NamespacedType) or _name(kind) != QUATERNION:
        raise StudyError(f"{call.function} is of a quaternion; {shown} is {_described(kind)}")
    angle = ANGLES[call.function]

    def read(message: Any) -> float:
        quaternion = _followed(message, path)  # type: ignore[arg-type]
        return angle(np.array([getattr(quaternion, name) for name in COMPONENTS]))

    return read


def _length(cls: Any, call: FieldCall) -> Callable[[Any], float]:
    (argument,) = call.arguments
    if not isinstance(argument, tuple):
        values = _values(cls, argument, call)
        return lambda message: float(len(values(message)))
    path = argument
    kind = kind_at(cls, path, spread=True)
    if not isinstance(kind, AbstractNestedType):
        raise StudyError(f"len is of an array; {_shown(path)} is {_described(kind)}")
    return lambda message: float(sum(map(len, all_at(message, path, last=False))))


def _values(cls: Any, argument: Argument, call: FieldCall) -> Callable[[Any], Array]:
    """Return a function that takes the values (n,) of an argument out of a message."""
    if isinstance(argument, float):
        constant = np.array([argument])
        return lambda message: constant
    if isinstance(argument, FieldCall):
        if argument.function in FILTERS:
            keep = FILTERS[argument.function]
            inner = _values(cls, argument.arguments[0], call)
            return lambda message: keep(inner(message))
        single = _single(cls, argument)
        return lambda message: np.array([single(message)])
    path = argument
    kind = kind_at(cls, path, spread=True)
    if isinstance(kind, AbstractNestedType):
        kind = kind.value_type
    names: list[str] = []
    if isinstance(kind, NamespacedType):
        # A vector is its components.
        types = field_types(_class_of(kind))
        names = [name for name, each in types.items() if _is_number(each)]
        if len(names) < len(types) or not names:
            raise StudyError(
                f"{call.function} is of numbers; {_shown(path)} is {_described(kind)}, with the "
                f"fields {', '.join(types)}"
            )
    elif not _is_number(kind):
        raise StudyError(f"{call.function} is of numbers; {_shown(path)} is {_described(kind)}")

    def read(message: Any) -> Array:
        items = all_at(message, path)
        if names:
            items = [getattr(item, name) for item in items for name in names]
        values = [np.atleast_1d(np.asarray(item, np.float64)) for item in items]
        return np.concatenate(values) if values else np.empty(0)

    return read


def kind_at(cls: Any, path: FieldPath, spread: bool = False) -> AbstractType:
    """Return the type of what a path leads to; with `spread` through all items of an array."""
    here: Any = cls
    kind: AbstractType | None = None
    for depth, part in enumerate(path):
        shown = _shown(path[: depth + 1])
        if here is None:
            raise StudyError(f"{_shown(path[:depth])} is a number and has no fields")
        types = field_types(here)
        if part.name not in types:
            raise StudyError(
                f"{type_name(here)} has no field '{part.name}'; "
                f"{checks.suggestion(part.name, types)}"
            )
        kind = _part_type(types, part, shown)
        inner = kind
        if isinstance(kind, AbstractNestedType) and depth < len(path) - 1:
            if not spread:
                by_name = f" or {shown}[NAME]" if "name" in types else ""
                raise StudyError(f"{shown} is an array; name one item, such as {shown}[0]{by_name}")
            inner = kind.value_type
        here = _class_of(inner) if isinstance(inner, NamespacedType) else None
    if kind is None:
        raise StudyError("names no field")
    return kind


def _part_type(types: Mapping[str, AbstractType], part: FieldPart, shown: str) -> AbstractType:
    kind = types[part.name]
    if part.item is None:
        return kind
    if not isinstance(kind, AbstractNestedType):
        raise StudyError(f"{shown} is no array; leave out [{part.item}]")
    if isinstance(part.item, slice):
        return kind
    if isinstance(part.item, str) and not isinstance(types.get("name"), AbstractNestedType):
        raise StudyError(f"{shown} has no array of names beside it; expected a number in [ ]")
    if isinstance(kind, ArrayType) and isinstance(part.item, int) and part.item >= kind.size:
        raise StudyError(f"{shown} has {kind.size} items, the last one is {shown}[{kind.size - 1}]")
    return kind.value_type


def _followed(message: Any, path: FieldPath) -> Any:
    """Return what a path leads to, one item of each array."""
    value = message
    for part in path:
        holder, value = value, getattr(value, part.name)
        if part.item is not None:
            value = _item(holder, part, value)
    return value


def all_at(message: Any, path: FieldPath, last: bool = True) -> list[Any]:
    """Return all that a path leads to, through all items of the arrays on it.

    An array of numbers at its end is one of them; one of messages is taken apart as well, unless
    the `last` is to stay whole.
    """
    items = [message]
    for depth, part in enumerate(path):
        holders, items = items, []
        for holder in holders:
            value = getattr(holder, part.name)
            if isinstance(part.item, slice):
                value = value[part.item]
            elif part.item is not None:
                items.append(_item(holder, part, value))
                continue
            is_list = isinstance(value, list)
            if is_list and (last or depth < len(path) - 1):
                items += value
            else:
                items.append(value)
    return items


def _item(holder: Any, part: FieldPart, values: Sequence[Any]) -> Any:
    try:
        index = list(holder.name).index(part.item) if isinstance(part.item, str) else part.item
        return values[index]  # type: ignore[index]
    except (ValueError, IndexError):
        raise _missing(part, holder, values) from None


def _missing(part: FieldPart, holder: Any, values: Sequence[object]) -> ItemMissingError:
    if isinstance(part.item, str) and part.item not in list(holder.name):
        near = brief(checks.suggestion(part.item, holder.name))
        return ItemMissingError(f"has no '{part.item}' among its names; {near}", holder.name)
    return ItemMissingError(f"has {len(values)} items in {part.name}, none for [{part.item}]")


def _holder(cls: Any, path: FieldPath) -> Any:
    """Return the class that the last field of a path is of."""
    for part in path[:-1]:
        kind = field_types(cls)[part.name]
        cls = _class_of(kind.value_type if isinstance(kind, AbstractNestedType) else kind)
    return cls


def _shown(path: FieldPath) -> str:
    return ".".join(part.name for part in path)


def _class_of(kind: AbstractType) -> Any:
    return interface_class(_name(kind))


def _name(kind: Any) -> str:
    return "/".join(kind.namespaced_name())


def _is_number(kind: AbstractType) -> bool:
    return isinstance(kind, BasicType) and kind.typename != OCTET


def _described(kind: AbstractType) -> str:
    if isinstance(kind, NamespacedType):
        return f"a {_name(kind)}"
    if isinstance(kind, AbstractNestedType):
        return "an array"
    return "a number" if _is_number(kind) else "text"
