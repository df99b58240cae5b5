"""The unit that a text about a parameter names in brackets, such as `[V/rad]`."""

import re

_BASE = (
    r"(?:(?:da|[munpfµμcdhkMGT])?(?:Nm|Hz|Pa|Wb|ohm|Ω|rad|bar|mol|[mgsAKNVWJFHTC])"
    r"|°C?|%|deg|degC|min|h|rpm|rev|px|dB|ft|lb|kn|lx|L|l)"
)
_TERM = rf"{_BASE}(?:(?:\^|\*\*)?-?[0-9]|⁻?[¹²³⁴])?"
_PRODUCT = rf"{_TERM}(?:[ ·⋅*]{_TERM})*"
_GROUP = rf"(?:{_PRODUCT}|1|\({_PRODUCT}(?:/{_PRODUCT})*\))"
UNIT = re.compile(rf"(?!1(?:[\])]|$)){_GROUP}(?: ?/ ?{_GROUP})*")
"""A unit in the symbols of the SI and its neighbours; a range `[0, 1]` or a word is none."""
_BRACKETS = re.compile(rf"\[(?!N/A)({UNIT.pattern})\]|(?<!\S)\(({UNIT.pattern})\)")


def unit_in(text: str) -> str:
    """Return the first unit in square or round brackets of a text; empty if there is none."""
    match = _BRACKETS.search(text)
    return (match[1] or match[2]) if match else ""
