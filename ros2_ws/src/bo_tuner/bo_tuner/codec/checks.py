"""Checks of single values from a study file.

Each returns the value in its Python type or raises a `StudyError`; `path` is the key path to the
value, relative to the object that is checked.
"""

import difflib
import math
import re
import struct
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from bo_tuner import maxima
from bo_tuner.errors import StudyError

ParameterValue = bool | int | float | str | tuple[bool | int | float | str, ...]
"""What a ROS parameter can hold."""

# ROS 2 stores an integer parameter in 64 bits.
INTEGER_LIMIT = 2**63
LONGEST_NAME = 255

SIMPLE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
PARAMETER_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z0-9_]+)*")
ITEM = r"(\[(?P<item>0|[1-9][0-9]{0,5})\])?"
PARAMETER_OR_ITEM = re.compile(rf"(?P<array>{PARAMETER_NAME.pattern}){ITEM}")
IN_NODE = re.compile(rf"(?P<array>.+?){ITEM}")
"""A parameter as its node names it, such as `gains.ur5e/wrist-1.p`, or an item of an array."""
NODE_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
TOPIC_NAME = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
OBJECT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", re.ASCII)


def same_value(one: object, other: object) -> bool:
    """Return whether two parameter values are equal; 1 and 1.0 are, 1 and true are not.

    A node that declares a double may be given an integer. NaN equals itself.
    """
    if isinstance(one, bool) != isinstance(other, bool):
        return False
    if isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        return len(one) == len(other) and all(map(same_value, one, other))
    return one == other or repr(one) == repr(other)


def holds(actual: object, sent: object) -> bool:
    """Return whether a node has a value that it was sent: the same, or that rounded to 32 bits.

    Some devices behind a parameter keep a double as a float.
    """
    if same_value(actual, sent):
        return True
    if isinstance(actual, (list, tuple)) and isinstance(sent, (list, tuple)):
        return len(actual) == len(sent) and all(map(holds, actual, sent))
    if not isinstance(actual, float) or not isinstance(sent, float):
        return False
    try:
        rounded: float
        (rounded,) = struct.unpack("f", struct.pack("f", sent))
    except OverflowError:
        return False
    # A number that becomes 0 is lost, not rounded.
    return actual == rounded != 0.0


def show(value: object) -> str:
    """Return a short one-line description of a value for an error message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value) if abs(value) < INTEGER_LIMIT else "an integer beyond 64 bits"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return f"text {quoted(value)}"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return f"a {type(value).__name__}"


def quoted(value: str) -> str:
    """Return text in quotation marks, on one line and shortened, for an error message."""
    return repr(value) if len(value) <= 60 else f"{value[:57]!r}..."


def meant(value: str, allowed: Iterable[str]) -> str:
    """Return "did you mean ..." for a likely typo, otherwise nothing."""
    names = list(allowed)
    near = [name for name in names if len(value) > 2 and value in name]
    near += difflib.get_close_matches(value[:80], names, n=1, cutoff=0.7)
    return f"did you mean '{near[0]}'?" if near else ""


def suggestion(value: str, allowed: Iterable[str]) -> str:
    """Return "did you mean ..." for a likely typo, otherwise the allowed names."""
    names = list(allowed)
    if hint := meant(value, names):
        return hint
    return f"expected one of {', '.join(names)}" if names else "there are none"


def integer(
    value: object,
    *path: str | int,
    at_least: int = -INTEGER_LIMIT,
    at_most: int = INTEGER_LIMIT,
) -> int:
    """Return `value` if it is an integer: neither 3.0 nor "3" nor true is one."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise StudyError(f"expected an integer, found {show(value)}", path)
    if not -INTEGER_LIMIT <= value < INTEGER_LIMIT:
        raise StudyError(f"expected a 64-bit integer, found {show(value)}", path)
    if value < at_least:
        raise StudyError(f"expected an integer of at least {at_least}, found {value}", path)
    if value > at_most:
        raise StudyError(f"expected an integer of at most {at_most}, found {value}", path)
    return value


def at_most(items: Collection[object], most: int, *path: str | int) -> None:
    """Refuse more than `most` items."""
    if len(items) > most:
        raise StudyError(f"expected at most {most} entries, found {len(items)}", path)


def number(value: object, *path: str | int) -> float:
    """Return `value` as a float if it is a finite number; an integer is one, true is not."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise StudyError(f"expected a number, found {show(value)}", path)
    if isinstance(value, int):
        value = integer(value, *path)
    if not math.isfinite(value):
        raise StudyError(f"expected a finite number, found {show(value)}", path)
    return float(value)


def magnitude(value: object, *path: str | int) -> float:
    """Return `value` as a float if it and its square are numbers that can be computed with.

    Its size is 0, or from the inverse of `maxima.MAGNITUDE` to `maxima.MAGNITUDE`.
    """
    checked = number(value, *path)
    if checked != 0.0 and not 1.0 / maxima.MAGNITUDE <= abs(checked) <= maxima.MAGNITUDE:
        raise StudyError(
            f"expected 0, or a number between {1.0 / maxima.MAGNITUDE:g} and "
            f"{maxima.MAGNITUDE:g} in size, found {checked:g}",
            path,
        )
    return checked


def boolean(value: object, *path: str | int) -> bool:
    """Return `value` if it is true or false."""
    if not isinstance(value, bool):
        raise StudyError(f"expected true or false, found {show(value)}", path)
    return value


def text(value: object, *path: str | int) -> str:
    """Return `value` if it is text."""
    if not isinstance(value, str):
        raise StudyError(f"expected text, found {show(value)}", path)
    try:
        value.encode()
    except UnicodeEncodeError:
        raise StudyError(f"expected text in Unicode, found {show(value)}", path) from None
    return value


def matching(value: object, pattern: re.Pattern[str], expected: str, *path: str | int) -> str:
    """Return `value` if it is text that matches `pattern`, which `expected` describes."""
    if not isinstance(value, str) or not pattern.fullmatch(value):
        raise StudyError(f"expected {expected}, found {show(value)}", path)
    return value


def node_name(value: object, *path: str | int) -> str:
    """Return `value` if it is the name of a node, relative to the tuner's namespace or in full."""
    return matching(value, NODE_NAME, "a node name such as axis or /arm/axis", *path)


def parameter_name(value: object, *path: str | int) -> str:
    """Return `value` if it can name a parameter of a study; dots separate groups."""
    return matching(value, PARAMETER_NAME, "a parameter name such as gains.kp", *path)


def parameter_or_item(value: object, *path: str | int) -> str:
    """Return `value` if it can name a parameter of a study, or an item of one that is an array."""
    expected = (
        "a parameter name such as gains.kp or covariance[7], and any other name that the node has "
        "for it under parameter"
    )
    return matching(value, PARAMETER_OR_ITEM, expected, *path)


def is_in_node(name: object) -> bool:
    """Whether a parameter can be addressed by its name in a node; ROS permits many characters."""
    return isinstance(name, str) and 0 < len(name) <= LONGEST_NAME and name.isprintable()


def name_in_node(value: object, *path: str | int) -> str:
    """Return `value` if it can be the name that a node has for a parameter, or an item of one."""
    if not isinstance(value, str) or not is_in_node(value):
        expected = f"the name of a ROS parameter, up to {LONGEST_NAME} printable characters"
        raise StudyError(f"expected {expected}, found {show(value)}", path)
    return value


def choice(value: object, allowed: Sequence[str], *path: str | int) -> str:
    """Return `value` if it is one of `allowed`."""
    if not isinstance(value, str):
        raise StudyError(f"expected one of {', '.join(allowed)}, found {show(value)}", path)
    if value not in allowed:
        raise StudyError(f"unknown {quoted(value)}; {suggestion(value, allowed)}", path)
    return value


def reference(value: object, kind: str, known: Iterable[str], *path: str | int) -> str:
    """Return `value` if it names a known object of a `kind`, such as a node."""
    names = list(known)
    if not isinstance(value, str):
        raise StudyError(f"expected the name of a {kind}, found {show(value)}", path)
    if value not in names:
        raise StudyError(f"there is no {kind} {quoted(value)}; {suggestion(value, names)}", path)
    return value


def mapping(value: object, *path: str | int) -> Mapping[Any, Any]:
    """Return `value` if it is a mapping."""
    if not isinstance(value, Mapping):
        raise StudyError(f"expected a mapping, found {show(value)}", path)
    return value


def sequence(value: object, expected: str, *path: str | int) -> tuple[object, ...]:
    """Return the items of a list as a tuple."""
    if not isinstance(value, (list, tuple)):
        raise StudyError(f"expected {expected}, found {show(value)}", path)
    return tuple(value)


def check_width(lower: float, upper: float, *path: str | int, instead: str) -> None:
    """Refuse bounds that are equal or reversed.

    `instead` says to the user what to write for a value that does not vary.
    """
    if lower > upper:
        raise StudyError(f"lower bound {lower} is not below upper bound {upper}", path)
    if lower == upper:
        raise StudyError(f"both bounds are {lower}; {instead}", path)


def parameter_value(value: ParameterValue, *path: str | int) -> ParameterValue:
    """Return what a ROS parameter can hold: a finite number, text, a truth value, or a list."""
    if isinstance(value, tuple):
        at_most(value, maxima.CONSTANTS, *path)
        if len({type(item) for item in value}) != 1:
            raise StudyError("expected a list of values of one type, at least one", path)
    return value
