"""One table per node for its parameters: type, range, unit and text in one line each.

A node's parameters are the fields of a frozen dataclass. `parameter` attaches to a field what a
user must know about it; `specifications` reads the table back (ROS descriptors and the documents'
tables come from it) and `build` turns a mapping into a checked instance, or refuses it and names
the value and the rule that it breaks. Rules between parameters belong in the dataclass's
``__post_init__``. The values themselves are data: `load_defaults` reads them from a ROS parameter
file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import yaml

from feed_axis_common.errors import SettingsError

T = TypeVar("T")


@dataclass(frozen=True)
class Specification:
    """What the table says about one parameter.

    `kind` is ``bool``, ``int``, ``float``, ``str`` or ``tuple`` (of floats); `lower` and `upper`
    are inclusive and hold for each item of a tuple.
    """

    name: str
    kind: type
    unit: str
    text: str
    lower: float | None
    upper: float | None
    choices: tuple[str, ...]

    @property
    def description(self) -> str:
        """The text with the unit in brackets, as shown in a ROS parameter descriptor."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text


def parameter(
    unit: str,
    text: str,
    *,
    lower: float | None = None,
    upper: float | None = None,
    choices: Sequence[str] = (),
) -> Any:
    """Declare a dataclass field as a node parameter; see `Specification` for the arguments."""
    return field(
        metadata={
            "unit": unit,
            "text": text,
            "lower": lower,
            "upper": upper,
            "choices": tuple(choices),
        }
    )


def specifications(table: type) -> tuple[Specification, ...]:
    """Read the parameter table of a dataclass made with `parameter`, in the order of its fields."""
    hints = get_type_hints(table)
    return tuple(
        Specification(
            name=f.name,
            kind=hints[f.name] if hints[f.name] in (bool, int, float, str) else tuple,
            **f.metadata,
        )
        for f in fields(table)
    )


def build(table: type[T], values: Mapping[str, object]) -> T:
    """Make a checked instance of a parameter table.

    Parameters
    ----------
    table
        Dataclass with fields that were declared with `parameter`.
    values
        A value for each parameter. A whole number is taken for a float, never a float for an
        integer.

    Raises
    ------
    SettingsError
        If a parameter is unknown or missing, has the wrong type, is not finite, lies out of its
        range, or if the set breaks a rule of the table; the message names the value and the rule.
    """
    known = {spec.name: spec for spec in specifications(table)}
    for name in values:
        if name not in known:
            raise SettingsError(f"{name}: unknown parameter; expected one of {', '.join(known)}")
    for name in known:
        if name not in values:
            raise SettingsError(f"{name}: missing")
    return table(**{name: _checked(known[name], value) for name, value in values.items()})


def load_defaults(path: Path) -> dict[str, Any]:
    """Read parameter values from a YAML file, ``/**: {ros__parameters: {name: value}}``."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    (section,) = document.values()
    return dict(section["ros__parameters"])


def config_directory(package_file: str) -> Path:
    """Find the ``config`` directory of the package that a module's ``__file__`` belongs to.

    In a source tree it lies beside the Python package; once installed, by pip or by colcon, under
    ``share``.
    """
    package = Path(package_file).resolve().parent
    source = package.parent / "config"
    if source.is_dir():
        return source
    return package.parents[3] / "share" / package.name / "config"


def _checked(spec: Specification, value: object) -> object:
    if spec.kind is tuple:
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) == 0:
            raise SettingsError(f"{spec.name}: {value!r} is not a list of at least one number")
        return tuple(_number(spec, float, item) for item in value)
    if spec.kind is str:
        if not isinstance(value, str) or (spec.choices and value not in spec.choices):
            expected = f"one of {', '.join(spec.choices)}" if spec.choices else "a string"
            raise SettingsError(f"{spec.name}: {value!r} is not {expected}")
        return value
    if spec.kind is bool:
        if not isinstance(value, bool):
            raise SettingsError(f"{spec.name}: {value!r} is not true or false")
        return value
    return _number(spec, spec.kind, value)


def _number(spec: Specification, kind: type, value: object) -> object:
    accepted = int if kind is int else (int, float)
    if isinstance(value, bool) or not isinstance(value, accepted):
        expected = "an integer" if kind is int else "a number"
        raise SettingsError(f"{spec.name}: {value!r} is not {expected}")
    if not isfinite(value):
        raise SettingsError(f"{spec.name}: {value!r} is not finite")
    unit = f" {spec.unit}" if spec.unit else ""
    if spec.lower is not None and value < spec.lower:
        raise SettingsError(f"{spec.name}: {value} is below the lower limit {spec.lower}{unit}")
    if spec.upper is not None and value > spec.upper:
        raise SettingsError(f"{spec.name}: {value} is above the upper limit {spec.upper}{unit}")
    return kind(value)
