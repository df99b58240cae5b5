"""What a service or an action says of what it was asked for: whether it was done, and why not."""

from collections.abc import Iterator, Mapping
from typing import Any

from bo_tuner.backends.ros.fields import ItemMissingError, all_at, kind_at
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.study.fields import field_path
from bo_tuner.text import brief

FLAGS = (
    "success",
    "ok",
    "mode_sent",
    "status.success",
    "result.successful",
    "results.successful",
)
"""Fields of answers that are true where it was done, and of all items of arrays on their way."""
CODES = {"return_code": "ERROR_NONE", "result.result": "RESULT_OK", "error_code.val": "SUCCESS"}
"""Fields with a code, and the constant beside each that it has where it was done."""
WORDS = (
    "message",
    "reason",
    "error_msg",
    "error_message",
    "error_string",
    "status_message",
)
"""Fields with a text about that."""


def check_expected(cls: Any, expected: Mapping[str, object]) -> None:
    """Refuse fields that answers of a type do not have."""
    for name in expected:
        with under(name):
            kind_at(cls, field_path(name), spread=True)


def refusal(answer: Any, expected: Mapping[str, object]) -> str:
    """Return why something was not done, by the answer of a service; empty if it was."""
    try:
        for holder, name, wanted, found in _judged(answer, expected):
            if not checks.same_value(found, wanted):
                return said(holder) or said(answer) or f"{name} is {checks.show(found)}"
    except ItemMissingError as missing:
        return f"its answer {missing}"
    return ""


def said(holder: Any) -> str:
    """Return the text about its result that a message has; empty if it has none."""
    texts = (getattr(holder, name, "") for name in WORDS)
    return next((brief(text) for text in texts if isinstance(text, str) and text), "")


def _judged(
    answer: Any, expected: Mapping[str, object]
) -> Iterator[tuple[Any, str, object, object]]:
    """Yield by which fields an answer is judged: their message, name, wanted value and value."""
    for name, wanted in expected.items():
        for holder, found in _values(answer, name):
            yield holder, name, wanted, found
    for name in FLAGS:
        for holder, found in _values(answer, name) if name not in expected else ():
            if isinstance(found, bool):
                yield holder, name, True, found
    for name, constant in CODES.items():
        for holder, found in _values(answer, name) if name not in expected else ():
            # Elsewhere the same name may mean anything.
            if (code := getattr(type(holder), constant, None)) is not None:
                yield holder, name, code, found


def _values(answer: Any, name: str) -> Iterator[tuple[Any, object]]:
    """Yield the values of a field, each with the message that it is of; none without the field."""
    *way, last = field_path(name)
    try:
        for holder in all_at(answer, tuple(way)) if way else [answer]:
            for found in all_at(holder, (last,)):
                yield holder, found
    except AttributeError:
        return
