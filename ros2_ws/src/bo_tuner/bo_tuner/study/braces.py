"""Names of contexts and parameters in braces: in steps, in conditions, in what starts a node.

``{x: "{goal_x}"}`` is the number itself, and ``"go to {room}"`` a text with it. ``{{room}}`` is the
text ``{room}``, and ``${HOME}`` is left to a shell. In a condition each is a number.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.trials import Value

Values = Mapping[str, Value]
"""Values of contexts and parameters by their names."""

_NAMED = re.compile(
    rf"(?<!\$)\{{\{{(?P<literal>{checks.PARAMETER_NAME.pattern})\}}\}}"
    rf"|(?<!\$)\{{(?P<name>{checks.PARAMETER_NAME.pattern})\}}"
)


def filled(content: Any, values: Values) -> Any:
    """Return what a step sends, mappings and lists included, with values for names in braces."""
    if isinstance(content, Mapping):
        return {key: filled(item, values) for key, item in content.items()}
    if isinstance(content, (list, tuple)):
        return [filled(item, values) for item in content]
    if not isinstance(content, str):
        return content
    whole = _NAMED.fullmatch(content)
    if whole is not None and whole["name"]:
        return values[whole["name"]]
    return filled_text(content, values)


def filled_text(text: str, values: Values) -> str:
    """Return a text with values for names in braces."""

    def in_text(match: re.Match[str]) -> str:
        return _text(values[match["name"]]) if match["name"] else f"{{{match['literal']}}}"

    return _NAMED.sub(in_text, text)


def filled_condition(condition: str, values: Values) -> str:
    """Return a condition on signals with numbers for names in braces; a truth value is 1 or 0."""

    def number(match: re.Match[str]) -> str:
        name = match["name"]
        return f"({float(values[name])!r})" if name else match[0]

    return _NAMED.sub(number, condition)


def without_names(condition: str) -> str:
    """Return a condition on signals with any numbers for names in braces."""
    return _NAMED.sub(lambda match: "(1.0)" if match["name"] else match[0], condition)


def names_in(content: Any) -> Iterator[str]:
    """Yield the names in braces in what a step sends, or in a condition."""
    if isinstance(content, Mapping):
        content = list(content.values())
    if isinstance(content, (list, tuple)):
        for item in content:
            yield from names_in(item)
    elif isinstance(content, str):
        yield from (match["name"] for match in _NAMED.finditer(content) if match["name"])


def _text(value: Value) -> str:
    """Return a value as text: a truth value as ``true`` or ``false``, a number in full.

    YAML takes ``1e-05`` for a text, and ``1.0e-05`` for a number.
    """
    text = str(value).lower() if isinstance(value, bool) else str(value)
    is_whole = isinstance(value, float) and "e" in text and "." not in text
    return text.replace("e", ".0e") if is_whole else text
