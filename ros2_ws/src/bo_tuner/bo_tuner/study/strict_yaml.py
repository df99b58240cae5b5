"""A strict YAML reader and writer for files that people edit by hand.

Reads the parser's events, so no Python object is ever constructed: a document of mappings, lists
and scalars, without tags, anchors or repeated keys. Plain scalars follow the core schema of
YAML 1.2, in which 1e-3 is a number and `on` is text, unlike PyYAML's loader.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

from bo_tuner.codec.checks import show
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.text import one_line

MAX_DEPTH = 20
LONGEST_LINE = 10**9
"""Width of lines that are not to be broken."""

Scalar = None | bool | int | float | str

_NULL = re.compile(r"null|Null|NULL|~|")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")

# Enough for every 64-bit integer; Python refuses to convert thousands of digits.
_MAX_DIGITS = 25


@dataclass
class Document:
    """A parsed YAML document.

    Attributes
    ----------
    value : object
        Nested dictionaries, lists and scalars.
    lines : dict from path to int
        Line of each key and list item, from 1, by its key path.
    """

    value: object = None
    lines: dict[KeyPath, int] = field(default_factory=dict)


def parse(text: str) -> Document:
    """Read one YAML document.

    Parameters
    ----------
    text : str
        The document.

    Raises
    ------
    StudyError
        If the text is not valid YAML or uses an unsupported feature; carries the line.
    """
    try:
        return _Reader(text).read()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = one_line(str(error.problem or error.context))
        raise StudyError(
            f"not valid YAML: {problem}", line=mark.line + 1 if mark else None
        ) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise StudyError(
            f"not a text file: character {error.character:#x} is not permitted", line=line
        ) from None


class _Reader:
    def __init__(self, text: str) -> None:
        self._events: Iterator[Any] = yaml.parse(text, Loader=yaml.SafeLoader)
        self._document = Document()

    def read(self) -> Document:
        next(self._events)  # Start of the stream.
        if isinstance(next(self._events), yaml.DocumentStartEvent):
            self._document.value = self._node(next(self._events), ())
            next(self._events)  # End of the document.
            event = next(self._events)
            if not isinstance(event, yaml.StreamEndEvent):
                raise self._error("expected a single document", event)
        return self._document

    def _node(self, event: Any, path: KeyPath) -> object:
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise self._error("anchors and aliases (& and *) are not supported", event, path)
        if event.tag is not None:
            raise self._error("tags (!) are not supported", event, path)
        if len(path) > MAX_DEPTH:
            raise self._error(f"nested deeper than {MAX_DEPTH} levels", event, path[:1])
        if isinstance(event, yaml.ScalarEvent):
            if event.implicit[0]:
                return self._plain(event, path)
            return event.value
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(path)
        return self._mapping(path)

    def _sequence(self, path: KeyPath) -> list[object]:
        items: list[object] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            key_path = (*path, len(items))
            self._document.lines[key_path] = _line(event)
            items.append(self._node(event, key_path))
        return items

    def _mapping(self, path: KeyPath) -> dict[str, object]:
        items: dict[str, object] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise self._error("expected text as a key", event, path)
            key = self._node(event, path)
            if not isinstance(key, str):
                raise self._error(f"expected text as a key, found {show(key)}", event, path)
            key_path = (*path, key)
            if key in items:
                first = self._document.lines[key_path]
                raise self._error(f"given twice, first in line {first}", event, key_path)
            self._document.lines[key_path] = _line(event)
            items[key] = self._node(next(self._events), key_path)
        return items

    def _plain(self, event: Any, path: KeyPath) -> Scalar:
        if _INTEGER.fullmatch(event.value) and len(event.value) > _MAX_DIGITS:
            raise self._error("integer of too many digits", event, path)
        return plain_scalar(event.value)

    @staticmethod
    def _error(problem: str, event: Any, path: KeyPath = ()) -> StudyError:
        return StudyError(problem, path, line=_line(event))


def _line(event: Any) -> int:
    line: int = event.start_mark.line
    return line + 1


def plain_scalar(text: str) -> Scalar:
    """Return the value of an unquoted scalar."""
    if _NULL.fullmatch(text):
        return None
    if _TRUE.fullmatch(text):
        return True
    if _FALSE.fullmatch(text):
        return False
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if match := _INFINITE.fullmatch(text):
        return float(f"{match[1]}inf")
    return float("nan") if _NAN.fullmatch(text) else text


def dump(value: object) -> str:
    """Return nested dictionaries, lists and scalars as YAML that `parse` reads back unchanged."""
    return str(
        yaml.serialize(_represent(value), Dumper=yaml.SafeDumper, allow_unicode=True, width=100)
    )


def dump_line(value: object) -> str:
    """Return a value as `dump` does, but on one line, in braces and brackets."""
    # As the item of a list in brackets: what is inside is written in this style, too.
    text = yaml.serialize(
        _represent([value]), Dumper=yaml.SafeDumper, allow_unicode=True, width=LONGEST_LINE
    )
    return str(text).strip()[1:-1]


def _represent(value: object) -> Any:
    if isinstance(value, dict):
        pairs = [(_represent(key), _represent(item)) for key, item in value.items()]
        return yaml.MappingNode("tag:yaml.org,2002:map", pairs, flow_style=not pairs)
    if isinstance(value, list):
        return yaml.SequenceNode(
            "tag:yaml.org,2002:seq", [_represent(item) for item in value], flow_style=True
        )
    if isinstance(value, str):
        # Quoted wherever this reader, not only PyYAML's, would not read it as text; in double
        # quotes, which alone escape, where a line break could be folded away.
        quoted = _FLOAT.fullmatch(value) or not isinstance(plain_scalar(value), str)
        style = '"' if quoted or not value.isprintable() else None
        return yaml.ScalarNode("tag:yaml.org,2002:str", value, style=style)
    return yaml.representer.SafeRepresenter().represent_data(value)
