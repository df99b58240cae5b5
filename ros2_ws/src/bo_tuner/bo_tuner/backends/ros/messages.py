"""Messages of any installed type: numbers out of them, and messages out of YAML."""

import importlib
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.type_support import check_for_type_support
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    BasicType,
    NamespacedType,
    UnboundedSequence,
)

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.building import under
from bo_tuner.study.offers import MOST_ITEMS
from bo_tuner.study.signals import FieldPart
from bo_tuner.text import brief, one_line

FLOATS = ("float", "double", "long double")
OCTET = "octet"
BYTES = (OCTET, "uint8", "int8", "char")
LARGEST_ARRAY = 1_000
"""Items to which an array grows that is given by the numbers in it."""
HEADER_TYPE = "std_msgs/msg/Header"
NO_SIGNALS = (
    HEADER_TYPE,
    "builtin_interfaces/msg/Time",
    "builtin_interfaces/msg/Duration",
    "std_msgs/msg/MultiArrayLayout",
)
"""Messages within messages whose numbers say when, or in which order, not what."""


class ItemMissingError(Exception):
    """A message has not the item of an array that a signal needs.

    Parameters
    ----------
    problem
        What it has not.
    names
        Those of its items, if the one that is needed is not among them.
    """

    def __init__(self, problem: str, names: Sequence[str] = ()) -> None:
        super().__init__(problem)
        self.names = names


def interface_class(name: str) -> Any:
    """Return the class of a message or service type such as ``std_msgs/msg/Float64``.

    Raises
    ------
    StudyError
        If it is not installed.
    """
    try:
        package, kind, interface = name.split("/")
        cls = getattr(importlib.import_module(f"{package}.{kind}"), interface)
    except (ImportError, AttributeError, ValueError):
        raise StudyError(f"type {name} is not installed") from None
    # It may be one for another Python, or lack another package, which shows only in use; by
    # exceptions of any kind.
    try:
        check_for_type_support(cls)
        if kind == "msg":
            cls()
    except Exception as error:
        cause = one_line(f"{type(error).__name__}: {error}")
        raise StudyError(f"type {name} cannot be loaded: {cause}") from None
    return cls


def is_bulky(cls: Any) -> bool:
    """Whether messages are raw bytes in any number, as images and point clouds are."""
    arrays = list(_arrays(cls).values())
    return bool(arrays) and all(
        isinstance(kind, UnboundedSequence) and kind.value_type.typename in BYTES for kind in arrays
    )


def number_arrays(cls: Any) -> list[str]:
    """Return the names of the fields that are arrays of numbers."""
    return [name for name, kind in _arrays(cls).items() if kind.value_type.typename != OCTET]


def _arrays(cls: Any) -> dict[str, AbstractNestedType]:
    """Return the types of the fields that are arrays of numbers, truth values or bytes."""
    return {
        name: kind
        for name, kind in _types(cls).items()
        if isinstance(kind, AbstractNestedType) and isinstance(kind.value_type, BasicType)
    }


def type_name(cls: Any) -> str:
    """Name of a message class, such as ``std_msgs/msg/Float64``."""
    package, kind, *_ = cls.__module__.split(".")
    return f"{package}/{kind}/{cls.__name__}"


def has_header(cls: Any) -> bool:
    """Whether messages have a header with a stamp."""
    return bool(cls.get_fields_and_field_types().get("header") == "std_msgs/Header")


def number_reader(cls: Any, path: Sequence[FieldPart]) -> Callable[[Any], float]:
    """Return a function that takes a number out of a message.

    It raises `ItemMissingError` for a message whose array does not have the item.

    Raises
    ------
    StudyError
        If messages of this type do not have the field, or it is no single number.
    """
    here = cls
    for depth, part in enumerate(path):
        shown = ".".join(p.name for p in path[: depth + 1])
        if here is None:
            raise StudyError(f"{shown.rpartition('.')[0]} is a number and has no fields")
        types = _types(here)
        if part.name not in types:
            raise StudyError(
                f"{type_name(here)} has no field '{part.name}'; "
                f"{checks.suggestion(part.name, types)}"
            )
        kind = _item_type(types, part, shown)
        if isinstance(kind, NamespacedType):
            here = interface_class("/".join(kind.namespaced_name()))
        elif isinstance(kind, BasicType) and kind.typename != OCTET:
            here = None
        else:
            raise StudyError(f"{shown} is text; expected a number")
    if here is not None:
        raise StudyError(
            f"{shown} is a {type_name(here)}; name one of its fields {', '.join(_types(here))}"
        )

    def read(message: Any) -> float:
        value = message
        for part in path:
            holder, value = value, getattr(value, part.name)
            if part.item is None:
                continue
            try:
                index = part.item
                value = value[list(holder.name).index(index) if isinstance(index, str) else index]
            except (ValueError, IndexError):
                raise _missing(part, holder, value) from None
        return float(value)

    return read


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


def number_writer(message: Any, path: Sequence[FieldPart]) -> NumberWriter:
    """Return what puts numbers into a field of a message; arrays grow until they have the item.

    Raises
    ------
    StudyError
        If the message does not have the field, or it is no single number.
    """
    number_reader(type(message), path)
    holder = message
    for part in path[:-1]:
        place = None if part.item is None else _grown(holder, part)
        holder = getattr(holder, part.name)
        holder = holder if place is None else holder[place]
    part = path[-1]
    kind: Any = _types(type(holder))[part.name]
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

    return NumberWriter(write, None if is_float else _limits(kind.typename))


def number_fields(message: Any) -> dict[str, bool | int | float]:
    """Return the numbers in a message that can be signals, by the path that `number_reader` takes.

    An array has the items that it has in this message, by the names beside it where there are any.
    """
    found: dict[str, bool | int | float] = {}
    for name, kind in _types(type(message)).items():
        value = getattr(message, name)
        if isinstance(kind, BasicType):
            if kind.typename != OCTET:
                found[name] = _number(kind, value)
        elif isinstance(kind, NamespacedType):
            if type_name(type(value)) not in NO_SIGNALS:
                found |= {f"{name}.{k}": number for k, number in number_fields(value).items()}
        elif (
            isinstance(kind, AbstractNestedType)
            and isinstance(kind.value_type, BasicType)
            and kind.value_type.typename != OCTET
            and len(value) <= MOST_ITEMS
        ):
            for label, item in zip(_labels(message, len(value)), value, strict=True):
                found[f"{name}[{label}]"] = _number(kind.value_type, item)
    return found


def make_message(cls: Any, values: Mapping[str, object], stamp: Any = None) -> Any:
    """Make a message of the values of its fields; a header without a stamp gets `stamp`.

    Raises
    ------
    StudyError
        If the type does not have a field, or the field cannot hold the value.
    """
    types = _types(cls)
    arguments = {}
    for name, value in values.items():
        if name not in types:
            raise StudyError(
                f"{type_name(cls)} has no field '{name}'; {checks.suggestion(name, types)}", (name,)
            )
        with under(name):
            arguments[name] = _value(types[name], value)
    # As keywords, arrays are taken as lists.
    message = cls(**arguments)
    given = values.get("header")
    if (
        stamp is not None
        and has_header(cls)
        and not (isinstance(given, Mapping) and "stamp" in given)
    ):
        message.header.stamp = stamp
    return message


def _number(kind: BasicType, value: Any) -> bool | int | float:
    """Return a number of a message, which may be NumPy's, as Python's."""
    if kind.typename == "boolean":
        return bool(value)
    return float(value) if kind.typename in FLOATS else int(value)


def _labels(message: Any, size: int) -> list[str]:
    """Name the items of an array: by the names beside it if these fit, else by their position."""
    names = getattr(message, "name", None)
    if not isinstance(names, list) or len(names) != size or len(set(names)) < size:
        return [str(index) for index in range(size)]
    # A name of digits only would be read as a position.
    readable = all(
        isinstance(name, str) and name and not name.isdigit() and not set(name) & set("[]")
        for name in names
    )
    return names if readable else [str(index) for index in range(size)]


def _types(cls: Any) -> dict[str, AbstractType]:
    return dict(zip(cls.get_fields_and_field_types(), cls.SLOT_TYPES, strict=True))


def _item_type(types: Mapping[str, AbstractType], part: FieldPart, shown: str) -> AbstractType:
    kind = types[part.name]
    if not isinstance(kind, AbstractNestedType):
        if part.item is not None:
            raise StudyError(f"{shown} is no array; leave out [{part.item}]")
        return kind
    if part.item is None:
        by_name = f" or {shown}[NAME]" if "name" in types else ""
        raise StudyError(f"{shown} is an array; name one item, such as {shown}[0]{by_name}")
    if isinstance(part.item, str) and not isinstance(types.get("name"), AbstractNestedType):
        raise StudyError(f"{shown} has no array of names beside it; expected a number in [ ]")
    if isinstance(kind, Array) and isinstance(part.item, int) and part.item >= kind.size:
        raise StudyError(f"{shown} has {kind.size} items, the last one is {shown}[{kind.size - 1}]")
    return kind.value_type


def _grown(holder: Any, part: FieldPart) -> int:
    """Return the position of an item in an array, which has it then."""
    items, kind = getattr(holder, part.name), _types(type(holder))[part.name]
    if isinstance(part.item, str):
        if part.item not in holder.name:
            raise StudyError(str(_missing(part, holder, items)))
        place = list(holder.name).index(part.item)
    else:
        place = part.item or 0
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


def _missing(part: FieldPart, holder: Any, value: Sequence[object]) -> ItemMissingError:
    if isinstance(part.item, str) and part.item not in list(holder.name):
        near = brief(checks.suggestion(part.item, holder.name))
        return ItemMissingError(f"has no '{part.item}' among its names; {near}", holder.name)
    return ItemMissingError(f"has {len(value)} items in {part.name}, none for [{part.item}]")


def _value(kind: AbstractType, value: object) -> Any:
    """Turn a value of YAML into what a field takes; rclpy itself checks nothing by default."""
    if isinstance(kind, AbstractNestedType):
        items = checks.sequence(value, "a list")
        found = []
        for index, item in enumerate(items):
            with under(index):
                found.append(_value(kind.value_type, item))
        if isinstance(kind, Array) and len(found) != kind.size:
            raise StudyError(f"expected {kind.size} items, found {len(found)}")
        return found
    if isinstance(kind, NamespacedType):
        if not isinstance(value, Mapping):
            raise StudyError(f"expected fields by name, found {checks.show(value)}")
        return make_message(interface_class("/".join(kind.namespaced_name())), value)
    if isinstance(kind, AbstractGenericString):
        return checks.text(value)
    if not isinstance(kind, BasicType) or kind.typename == OCTET:
        raise StudyError("bytes cannot be set")
    if kind.typename in FLOATS:
        return checks.number(value)
    if kind.typename == "boolean":
        return checks.boolean(value)
    return _integer(kind.typename, value)


def _limits(typename: str) -> tuple[int, int]:
    """Return the lowest and the highest integer of a type."""
    bits = int("".join(c for c in typename if c.isdigit()) or 8)
    if typename.startswith("u"):
        return 0, 2**bits - 1
    return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


def _integer(typename: str, value: object) -> int:
    lowest, highest = _limits(typename)
    if isinstance(value, bool) or not isinstance(value, int):
        raise StudyError(f"expected an integer, found {checks.show(value)}")
    if not lowest <= operator.index(value) <= highest:
        raise StudyError(f"expected an integer from {lowest} to {highest}, found {value}")
    return value
