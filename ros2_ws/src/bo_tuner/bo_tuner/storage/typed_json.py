"""Frozen dataclasses as JSON, and back, by the types of their fields.

JSON has no word for numbers that are not finite: null stands for them. It is read as NaN, or as the
number that `stands_for` gives the field. Values that follow from the fields can be written beside
them for readers in other languages; `from_json` ignores them.
"""

import dataclasses
import math
import types
from enum import StrEnum
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from bo_tuner.codec import checks
from bo_tuner.storage.json_numbers import without_nan

T = TypeVar("T")

_NULL = "null"


def stands_for(null: float) -> float:
    """Return the default of a field of numbers in which JSON's null is read as `null`, not NaN."""
    default: float = dataclasses.field(metadata={_NULL: null})
    return default


def to_json(value: Any) -> dict[str, object]:
    """Return a dataclass as JSON has it."""
    content = without_nan(dataclasses.asdict(value))
    return cast(dict[str, object], content)


def from_json(cls: type[T], content: object) -> T:
    """Return the dataclass that `to_json` has made this content of.

    Its fields may be dataclasses, text, numbers, truth values, enumerations of text, tuples of
    these or mappings from text to them, each or None.

    Raises
    ------
    ValueError
        If it is no such content, with the place of the first wrong value and what was expected.
    """
    value: T = _object(cls, content, "")
    return value


def _object(cls: Any, content: object, place: str) -> Any:
    if not isinstance(content, dict):
        raise _wrong(place, "an object", content)
    hints, values = get_type_hints(cls), {}
    for field in dataclasses.fields(cls):
        where = f"{place}.{field.name}" if place else field.name
        if field.name not in content:
            raise ValueError(f"{where}: missing")
        null = field.metadata.get(_NULL, math.nan)
        values[field.name] = _value(hints[field.name], content[field.name], where, null)
    return cls(**values)


def _value(hint: Any, content: object, place: str, null: float = math.nan) -> Any:
    """Return what JSON says of a value that has the type `hint`."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if content is None and type(None) in arguments:
            return None
        others = [argument for argument in arguments if argument is not type(None)]
        return _value(others[0], content, place) if len(others) == 1 else _plain(content, place)
    if origin is tuple:
        if not isinstance(content, list):
            raise _wrong(place, "a list", content)
        return tuple(
            _value(arguments[0], item, f"{place}[{index}]") for index, item in enumerate(content)
        )
    if origin is not None:
        if not isinstance(content, dict):
            raise _wrong(place, "an object", content)
        return {
            _text(name, place): _value(arguments[1], item, f"{place}.{name}")
            for name, item in content.items()
        }
    if dataclasses.is_dataclass(hint):
        return _object(hint, content, place)
    if hint is float:
        return null if content is None else _number(content, place)
    if hint is int:
        if type(content) is not int or abs(content) >= checks.INTEGER_LIMIT:
            raise _wrong(place, "a whole number", content)
        return content
    if hint is bool:
        if not isinstance(content, bool):
            raise _wrong(place, "true or false", content)
        return content
    if issubclass(hint, StrEnum):
        if content not in [*hint]:
            raise _wrong(place, f"one of {', '.join(hint)}", content)
        return hint(content)
    return _text(content, place)


def _plain(content: object, place: str) -> object:
    """Return a value of a parameter or a context: text, a number or a truth value."""
    if isinstance(content, str):
        return _text(content, place)
    if not isinstance(content, bool | int | float):
        raise _wrong(place, "text, a number, true or false", content)
    if not isinstance(content, bool):
        _number(content, place)
    return content


def _number(content: object, place: str) -> float:
    if not isinstance(content, int | float) or isinstance(content, bool):
        raise _wrong(place, "a number", content)
    try:
        number = float(content)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _wrong(place, "a finite number", content)
    return number


def _text(content: object, place: str) -> str:
    if not isinstance(content, str):
        raise _wrong(place, "text", content)
    try:
        content.encode()
    except UnicodeEncodeError:
        raise _wrong(place, "text in Unicode", content) from None
    return content


def _wrong(place: str, expected: str, content: object) -> ValueError:
    where = f"{place}: " if place else ""
    return ValueError(f"{where}expected {expected}, found {checks.show(content)}")
