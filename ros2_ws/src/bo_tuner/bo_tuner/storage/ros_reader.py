"""What ROS reads from a parameter file, by the rules of its parser, and where it stands there.

ROS does not read such a file as a tree: rcl_yaml_param_parser goes from one event of the YAML
parser to the next and keeps two names, of the node and of the parameter, to which keys are added
and from which they are removed. The same lines can therefore mean different things in two places.
This reader goes the same way, event by event; tests compare it with that parser on generated files.
That parser itself is not used, since it does not say where in the file a value stands.
"""

import re
from collections.abc import Iterator
from typing import Any

import yaml

from bo_tuner.codec.checks import quoted
from bo_tuner.errors import StudyError
from bo_tuner.storage.ros_sections import Scalar, Section, Setting, WrittenValue
from bo_tuner.storage.ros_values import read_value
from bo_tuner.text import one_line

SECTION = "ros__parameters"

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The YAML library that ROS itself uses, where PyYAML is built with it."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WILD = ("*", "**")
_LONGEST_NAMESPACE, _LONGEST_NAME = 245, 255
"""Characters of a level of the namespace with its slash, and of the name of a node."""


def is_parameter_file(text: str) -> bool:
    """Return whether a text is YAML with a section for nodes, even if ROS refuses it otherwise."""
    try:
        return any(
            isinstance(event, yaml.ScalarEvent) and event.value.startswith(SECTION)
            for event in yaml.parse(text, Loader=_LOADER)
        )
    except (yaml.YAMLError, UnicodeEncodeError):
        return False


def read_sections(text: str) -> list[Section]:
    """Return what ROS reads from a parameter file."""
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
        # The YAML library in the ROS wheels, older than PyYAML's, refuses these in brackets.
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
            written = section.settings[self._at].written
            if self._list_type is None:
                written.setdefault((True, type(None)), WrittenValue(is_list=True))
            key = (True, self._list_type or type(None))
            if self._list_in_brackets and key in written:
                written[key].span = (self._list_start, event.end_mark.index)
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
        written = section.settings[self._at].written
        if not self._in_list or self._list_type is None:
            written[self._in_list, kind] = WrittenValue(is_list=self._in_list)
        elif self._list_type is not kind:
            raise _refused("a list of values of several types", event)
        elif (True, kind) not in written:
            raise _refused("a list that goes on in another parameter", event)
        self._list_type = kind
        end = event.end_mark.index
        start = self._starts.get(end, event.start_mark.index)
        line = event.start_mark.line + 1
        written[self._in_list, kind].items.append(Scalar(value, start, end, line, style))
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
        # The parser, which comes next, raises this error with its line.
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
