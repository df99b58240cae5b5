"""Messages of any installed type: the numbers in them, and messages out of YAML."""

import importlib
import operator
from collections.abc import Mapping
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

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.study.offers import MOST_ITEMS
from bo_tuner.text import one_line

FLOATS = ("float", "double", "long double")
OCTET = "octet"
BYTES = (OCTET, "uint8", "int8", "char")
HEADER_TYPE = "std_msgs/msg/Header"
NO_SIGNALS = (
    HEADER_TYPE,
    "builtin_interfaces/msg/Time",
    "builtin_interfaces/msg/Duration",
    "std_msgs/msg/MultiArrayLayout",
)
"""Types of nested messages with times or sequence numbers, which are no signals."""


def interface_class(name: str) -> Any:
    """Return the class of a message or service type such as ``std_msgs/msg/Float64``."""
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
        for name, kind in field_types(cls).items()
        if isinstance(kind, AbstractNestedType) and isinstance(kind.value_type, BasicType)
    }


def type_name(cls: Any) -> str:
    """Name of a message class, such as ``std_msgs/msg/Float64``."""
    package, kind, *_ = cls.__module__.split(".")
    return f"{package}/{kind}/{cls.__name__}"


def has_header(cls: Any) -> bool:
    """Whether messages have a header with a stamp."""
    return bool(cls.get_fields_and_field_types().get("header") == "std_msgs/Header")


def number_fields(message: Any) -> dict[str, bool | int | float]:
    """Return the numbers in a message that can be signals, by the path of a signal's field.

    An array has the items that it has in this message, by the names beside it where there are any.
    """
    numbers: dict[str, bool | int | float] = {}
    for name, kind in field_types(type(message)).items():
        value = getattr(message, name)
        if isinstance(kind, BasicType):
            if kind.typename != OCTET:
                numbers[name] = _number(kind, value)
        elif isinstance(kind, NamespacedType):
            if type_name(type(value)) not in NO_SIGNALS:
                numbers |= {f"{name}.{k}": number for k, number in number_fields(value).items()}
        elif (
            isinstance(kind, AbstractNestedType)
            and isinstance(kind.value_type, BasicType)
            and kind.value_type.typename != OCTET
            and len(value) <= MOST_ITEMS
        ):
            for label, item in zip(_labels(message, len(value)), value, strict=True):
                numbers[f"{name}[{label}]"] = _number(kind.value_type, item)
    return numbers


def make_message(cls: Any, values: Mapping[str, object], stamp: Any = None) -> Any:
    """Make a message of the values of its fields; a header without a stamp gets `stamp`."""
    types = field_types(cls)
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


def field_types(cls: Any) -> dict[str, AbstractType]:
    """Return the types of the fields of a message class, by their names."""
    return dict(zip(cls.get_fields_and_field_types(), cls.SLOT_TYPES, strict=True))


def _value(kind: AbstractType, value: object) -> Any:
    """Turn a value of YAML into what a field takes; rclpy itself checks nothing by default."""
    if isinstance(kind, AbstractNestedType):
        items = checks.sequence(value, "a list")
        values = []
        for index, item in enumerate(items):
            with under(index):
                values.append(_value(kind.value_type, item))
        if isinstance(kind, Array) and len(values) != kind.size:
            raise StudyError(f"expected {kind.size} items, found {len(values)}")
        return values
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


def integer_limits(typename: str) -> tuple[int, int]:
    """Return the lowest and the highest integer of a type."""
    bits = int("".join(c for c in typename if c.isdigit()) or 8)
    if typename.startswith("u"):
        return 0, 2**bits - 1
    return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


def _integer(typename: str, value: object) -> int:
    lowest, highest = integer_limits(typename)
    if isinstance(value, bool) or not isinstance(value, int):
        raise StudyError(f"expected an integer, found {checks.show(value)}")
    if not lowest <= operator.index(value) <= highest:
        raise StudyError(f"expected an integer from {lowest} to {highest}, found {value}")
    return value
