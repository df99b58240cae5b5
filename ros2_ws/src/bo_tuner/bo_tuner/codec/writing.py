"""Objects as plain data, as YAML or JSON has it; `bo_tuner.codec.reading` reads it back."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from bo_tuner.codec.reading import Field, fields_of


def to_file(value: object) -> Any:
    """Return what a file has for a value: of an object the fields that are not empty."""
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return _inside(value, to_file)
    content: dict[str, Any] = {}
    for item in fields_of(type(value)):
        of_field = getattr(value, item.name)
        if item.is_key or _is_empty(of_field, item):
            continue
        if item.beside is None:
            content[item.name] = to_file(of_field)
            continue
        kinds = item.beside.kinds()
        content[item.name] = next(kind for kind in kinds if type(of_field) is kinds[kind])
        content |= to_file(of_field)
    return content


def to_json(value: object) -> Any:
    """Return what JSON has for a value; null stands for what is no finite number."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {item.name: to_json(getattr(value, item.name)) for item in fields}
    return (
        None if isinstance(value, float) and not math.isfinite(value) else _inside(value, to_json)
    )


def changes(value: Any) -> dict[str, Any]:
    """Return what JSON has for the fields of an object that are not their defaults."""
    cls: Any = type(value)
    return {
        item.name: to_json(getattr(value, item.name))
        for item in fields_of(cls)
        if item.is_required or getattr(value, item.name) != item.default
    }


def _inside(value: object, write: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: write(item) for key, item in value.items()}
    return [write(item) for item in value] if isinstance(value, list | tuple) else value


def _is_empty(value: object, item: Field) -> bool:
    # An empty text may be one of the choices of a parameter.
    return value is None or value in ((), {}) or (value == "" and item.field.default == "")
