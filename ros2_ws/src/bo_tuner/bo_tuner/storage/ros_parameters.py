"""What ROS reads from a parameter file, by the rules of its parser, and where it stands there.

ROS does not read such a file as a tree: rcl_yaml_param_parser goes from one event of the YAML
parser to the next and keeps two names, of the node and of the parameter, to which keys are added
and from which they are removed. What looks alike can therefore mean different things, and this
reader goes the same way, event by event; tests hold it against that parser with generated files.
The parser itself would not tell where a value stands, and a file could end the process.
"""

import ctypes
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

from bo_tuner.errors import StudyError
from bo_tuner.study.checks import quoted
from bo_tuner.text import one_line

SECTION = "ros__parameters"

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Where it can be, the YAML library that ROS itself uses."""

_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_DOTTED = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_TEXT_TAG = "tag:yaml.org,2002:str"

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WILD = ("*", "**")
_LONGEST_NAMESPACE, _LONGEST_NAME = 245, 255
"""Of a level of the namespace with its slash, and of the name of a node, in characters."""

Single = bool | int | float | str

_KINDS = (bool, int, float, str)
"""Where a parameter has been given values of several types, the first of these counts."""


@dataclass(frozen=True)
class Scalar:
    """A single value where it stands.

    Attributes
    ----------
    value
        As ROS reads it.
    start, end
        Of its text, without anchor and tag, in characters of the file; `end` is behind the last.
    line
        From 1.
    style
        The quotes, or ``|`` or ``>`` of a block; empty for a plain one.
    """

    value: Single
    start: int
    end: int
    line: int
    style: str


@dataclass
class Found:
    """A value that a parameter has been given: of one type, single or a list.

    Attributes
    ----------
    items
        Its single values in order.
    is_list
        Whether it is a list.
    span
        Start and end of a list in brackets, in characters of the file; otherwise None.
    """

    items: list[Scalar] = field(default_factory=list)
    is_list: bool = False
    span: tuple[int, int] | None = None

    @property
    def value(self) -> Single | list[Single]:
        """The value as ROS reads it; of a list without an item it reads none."""
        values = [item.value for item in self.items]
        return values if self.is_list else values[0]


@dataclass
class Setting:
    """A parameter of a section.

    Attributes
    ----------
    name
        Of the parameter, dots between its levels.
    found
        What it was given, by whether it is a list and by type.
    """

    name: str
    found: dict[tuple[bool, type], Found] = field(default_factory=dict)

    @property
    def counts(self) -> Found | None:
        """What ROS takes; None if it has no value."""
        for is_list in (False, True):
            for kind in (*_KINDS, type(None)):
                if (is_list, kind) in self.found:
                    return self.found[is_list, kind]
        return None


@dataclass
class Section:
    """What a file says of one node, or of those that a pattern names.

    Attributes
    ----------
    name
        Of node or pattern, such as ``/arm/**``; the slash ahead may be missing.
    settings
        In the order in which ROS goes through them.
    in_braces
        Whether its parameters stand in braces.
    column
        Of its first parameter, from 0; None as long as there is none.
    end
        Behind its last value, in characters of the file; 0 as long as there is none.
    """

    name: str
    settings: list[Setting] = field(default_factory=list)
    in_braces: bool = False
    column: int | None = None
    end: int = 0

    @property
    def pattern(self) -> str:
        """The name with the slash ahead."""
        return f"/{self.name.removeprefix('/')}"

    @property
    def is_wildcard(self) -> bool:
        """Whether it is of any nodes that a pattern names."""
        return "*" in self.name

    def is_of(self, node: str) -> bool:
        """Return whether a node, given by its full name, takes what this section says."""
        levels = self.pattern.replace("/*", r"(/\w+)")
        return re.fullmatch(levels, node, re.ASCII) is not None

    @property
    def values(self) -> dict[str, Single | list[Single]]:
        """The values by parameter."""
        every = ((setting.name, setting.counts) for setting in self.settings)
        return {name: found.value for name, found in every if found is not None}


@dataclass(frozen=True)
class Source:
    """Where a node's parameter comes from."""

    section: Section
    setting: Setting
    found: Found

    @property
    def line(self) -> int | None:
        """The line of its value, from 1."""
        return self.found.items[0].line if self.found.items else None


def full_name(node: str, namespace: str) -> str:
    """Return the full name of a node that is named relative to a namespace, or in full."""
    if node.startswith("/"):
        return node
    return f"/{namespace.strip('/')}/{node}" if namespace.strip("/") else f"/{node}"


def full_names(sections: list[Section], node: str, namespace: str = "") -> list[str]:
    """Return the full names that a node may have in a file.

    Parameters
    ----------
    sections
        Of the file.
    node
        The name of the node in a study.
    namespace
        Of the nodes of the study. Where none is named, and the file says nothing of a node in the
        root, the node counts in the namespaces that the file has it in.
    """
    name = full_name(node, namespace)
    if namespace or any(section.is_of(name) for section in sections):
        return [name]
    others = [s.pattern for s in sections if not s.is_wildcard and s.pattern.endswith(name)]
    return list(dict.fromkeys(others)) or [name]


def sources(sections: list[Section], node: str) -> dict[str, Source]:
    """Return where each parameter of a node comes from: of several sections the last.

    Parameters
    ----------
    sections
        Of a file.
    node
        The full name of the node, such as ``/arm/pid``.
    """
    found: dict[str, Source] = {}
    for section in sections:
        if section.is_of(node):
            for setting in section.settings:
                found.pop(setting.name, None)
                if (counts := setting.counts) is not None:
                    found[setting.name] = Source(section, setting, counts)
    return found


def is_parameter_file(text: str) -> bool:
    """Return whether a text is YAML with a section for nodes, however it may be refused."""
    try:
        return any(
            isinstance(event, yaml.ScalarEvent) and event.value.startswith(SECTION)
            for event in yaml.parse(text, Loader=_LOADER)
        )
    except (yaml.YAMLError, UnicodeEncodeError):
        return False


def read_sections(text: str) -> list[Section]:
    """Return what ROS reads from a parameter file.

    Parameters
    ----------
    text
        The content of the file, its line breaks as they are.

    Raises
    ------
    StudyError
        If ROS refuses it, with the line.
    """
    reader = _Reader(text)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            reader.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = one_line(str(error.problem or error.context))
        raise StudyError(
            f"not valid YAML: {problem}", line=mark.line + 1 if mark else None
        ) from None
    except (yaml.reader.ReaderError, UnicodeEncodeError) as error:
        raise StudyError("not a text file: a character that YAML does not permit") from error
    return reader.sections


def read_value(text: str, style: str = "", tag: str | None = None) -> Single:
    """Return what ROS takes a single value for.

    Parameters
    ----------
    text
        The value, without quotes.
    style
        Its quotes; empty for none.
    tag
        Of YAML.
    """
    if tag == _TEXT_TAG or style in ("'", '"'):
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    whole = _whole_number(text)
    if whole is not None:
        return whole
    dotted = _DOTTED.fullmatch(text)
    number = _number(text.replace(".", "") if dotted else text)
    return text if number is None else number


# ROS converts by these two functions: hexadecimal, octal, what is too large, and so on.
_C = ctypes.CDLL(None, use_errno=True)
_C.strtoll.restype = ctypes.c_longlong
_C.strtoll.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p), ctypes.c_int]
_C.strtod.restype = ctypes.c_double
_C.strtod.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)]


def _whole_number(text: str) -> int | None:
    data, rest = text.encode("utf-8", "replace"), ctypes.c_char_p()
    ctypes.set_errno(0)
    value: int = _C.strtoll(data, ctypes.byref(rest), 0)
    return value if data and not ctypes.get_errno() and rest.value == b"" else None


def _number(text: str) -> float | None:
    data, rest = text.encode("utf-8", "replace"), ctypes.c_char_p()
    ctypes.set_errno(0)
    value: float = _C.strtod(data, ctypes.byref(rest))
    return value if data and not ctypes.get_errno() and rest.value == b"" else None


class _Name:
    """A name that keys are added to and removed from, with the number of its levels."""

    def __init__(self, separator: str) -> None:
        self.text = ""
        self.levels = 0
        self._separator = separator

    def add(self, key: str) -> None:
        between = "" if not self.levels or self.text.endswith(self._separator) else self._separator
        self.text = f"{self.text}{between}{key}"
        self.levels += 1

    def replace(self, text: str) -> None:
        self.text = text
        self.levels += 1

    def remove(self) -> None:
        """Remove the last level: up to the last separator, also if that is within a key."""
        if self.levels == 1:
            self.text = ""
        elif self.levels and self._separator in self.text:
            self.text = self.text.rpartition(self._separator)[0]
        self.levels = max(self.levels - 1, 0)


class _Reader:
    """Takes the events of the YAML parser."""

    def __init__(self, text: str) -> None:
        self.sections: list[Section] = []
        # The events have the anchor and the tag of a value in its span, the tokens do not.
        self._starts = _value_starts(text)
        self._node = _Name("/")
        self._parameter = _Name(".")
        self._section: Section | None = None
        self._at = 0
        """Which of the section's settings is written."""
        self._in_parameters = False
        self._depth = 0
        self._key_is_next = True
        self._opens_level = False
        self._in_list = False
        self._list_type: type | None = None
        self._list_start = 0
        self._list_in_brackets = False
        self._braces: list[bool] = []

    def take(self, event: Any) -> None:
        if isinstance(event, yaml.ScalarEvent):
            self._check_plain(event)
            text = event.value.partition("\0")[0]
            if self._key_is_next:
                self._key(text, event)
                self._key_is_next = False
            else:
                self._value(text, event)
                self._key_is_next = not self._in_list
        elif isinstance(event, yaml.MappingStartEvent):
            self._open_mapping(event)
        elif isinstance(event, yaml.MappingEndEvent):
            self._close_mapping(event)
        elif isinstance(event, yaml.SequenceStartEvent):
            self._open_list(event)
        elif isinstance(event, yaml.SequenceEndEvent):
            self._close_list(event)
        elif isinstance(event, yaml.AliasEvent):
            raise _refused("ROS takes no aliases (*), such as those of merge keys (<<)", event)

    def _check_plain(self, event: Any) -> None:
        # The YAML library of the ROS wheels is older than Python's.
        if self._is_in_brackets and not event.style and re.search("[:?]", event.value):
            raise _refused(
                f"text with : or ? in brackets needs quotes: {quoted(event.value)}", event
            )

    @property
    def _is_in_brackets(self) -> bool:
        return any(self._braces) or (self._in_list and self._list_in_brackets)

    def _open_mapping(self, event: Any) -> None:
        self._depth += 1
        self._braces.append(bool(event.flow_style))
        self._key_is_next = True
        # The mapping of all parameters of a node opens no level of their names.
        is_outermost = self._in_parameters and self._depth - (self._node.levels + 1) == 2
        self._opens_level = not is_outermost

    def _close_mapping(self, event: Any) -> None:
        if self._in_parameters and self._parameter.levels:
            self._parameter.remove()
        elif self._in_parameters:
            self._in_parameters = False
        elif self._depth == self._node.levels + 1:
            self._node.remove()
        self._depth -= 1
        if self._braces.pop():
            self._ends(event)

    def _open_list(self, event: Any) -> None:
        if self._key_is_next:
            raise _refused("a list cannot be a key", event)
        if not self._in_parameters:
            raise _refused(f"a list ahead of {SECTION}", event)
        self._in_list = True
        self._list_type = None
        self._list_start = event.start_mark.index
        self._list_in_brackets = bool(event.flow_style)

    def _close_list(self, event: Any) -> None:
        section = self._section
        if section is not None and self._at < len(section.settings):
            found = section.settings[self._at].found
            if self._list_type is None:
                found.setdefault((True, type(None)), Found(is_list=True))
            key = (True, self._list_type or type(None))
            if self._list_in_brackets and key in found:
                found[key].span = (self._list_start, event.end_mark.index)
        self._in_list = False
        self._key_is_next = True
        if self._list_in_brackets:
            self._ends(event)

    def _key(self, text: str, event: Any) -> None:
        if not event.value:
            raise _refused("a key without text", event)
        if self._in_parameters:
            self._parameter_key(text, event)
        elif not text.startswith(SECTION):
            self._node.add(text)
        else:
            self._begin_section(event)

    def _begin_section(self, event: Any) -> None:
        if not self._node.levels:
            raise _refused(f"no name of a node above {SECTION}", event)
        name = self._node.text
        if not _is_pattern(name):
            raise _refused(f"{quoted(name)} is no name of a node", event)
        known = [section for section in self.sections if section.name == name]
        if not known:
            self.sections.append(Section(name))
        self._section = known[0] if known else self.sections[-1]
        self._node.remove()
        self._in_parameters = True

    def _parameter_key(self, text: str, event: Any) -> None:
        section = self._section
        if section is None:
            raise _refused(f"a parameter ahead of {SECTION}", event)
        if self._opens_level:
            if self._at >= len(section.settings):
                raise _refused("a mapping that belongs to no parameter", event)
            self._parameter.replace(section.settings[self._at].name)
            self._opens_level = False
        if self._parameter.levels:
            self._find(section, self._parameter.text)
            section.settings[self._at].name = f"{self._parameter.text}.{text}"
        else:
            self._find(section, text)
        if section.column is None:
            section.in_braces = any(self._braces)
            section.column = event.start_mark.column

    def _find(self, section: Section, name: str) -> None:
        names = [setting.name for setting in section.settings]
        if name in names:
            self._at = names.index(name)
        else:
            self._at = len(names)
            section.settings.append(Setting(name))

    def _value(self, text: str, event: Any) -> None:
        section = self._section
        if not self._in_parameters or section is None or not section.settings:
            raise _refused(f"a value ahead of {SECTION} or of a parameter", event)
        style = "" if event.style is None else event.style
        if not event.value and style not in ("'", '"'):
            raise _refused("a key without a value", event)
        if self._at >= len(section.settings):
            raise _refused("a value that belongs to no parameter", event)
        value = read_value(text, style, event.tag)
        kind = type(value)
        found = section.settings[self._at].found
        if not self._in_list or self._list_type is None:
            found[self._in_list, kind] = Found(is_list=self._in_list)
        elif self._list_type is not kind:
            raise _refused("a list of values of several types", event)
        elif (True, kind) not in found:
            raise _refused("a list that goes on in another parameter", event)
        self._list_type = kind
        end = event.end_mark.index
        start = self._starts.get(end, event.start_mark.index)
        line = event.start_mark.line + 1
        found[self._in_list, kind].items.append(Scalar(value, start, end, line, style))
        self._ends(event)

    def _ends(self, event: Any) -> None:
        if self._section is not None and self._in_parameters:
            self._section.end = event.end_mark.index


def _value_starts(text: str) -> dict[int, int]:
    """Return where the text of each single value begins, by where it ends."""
    return dict(_spans(text))


def _spans(text: str) -> Iterator[tuple[int, int]]:
    try:
        for token in yaml.scan(text, Loader=_LOADER):
            if isinstance(token, yaml.ScalarToken):
                yield token.end_mark.index, token.start_mark.index
    except (yaml.YAMLError, UnicodeEncodeError):
        # Which the parser tells, too.
        return


def _is_pattern(name: str) -> bool:
    """Return whether ROS takes a name for that of a node, or of several."""
    *above, node = name.split("/")
    levels = above[1:] if name.startswith("/") else above
    return _is_level(node, _LONGEST_NAME) and all(
        _is_level(level, _LONGEST_NAMESPACE - 1) for level in levels
    )


def _is_level(text: str, longest: int) -> bool:
    return text in _WILD or (_NAME.fullmatch(text) is not None and len(text) <= longest)


def _refused(problem: str, event: Any) -> StudyError:
    line: int = event.start_mark.line
    return StudyError(problem, line=line + 1)
