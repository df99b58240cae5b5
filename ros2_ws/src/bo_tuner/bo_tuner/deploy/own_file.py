"""Values in a user's own parameter file: only they change, everything else stays as it is."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import yaml

from bo_tuner.errors import StudyError
from bo_tuner.storage.parameter_file import NodeValues
from bo_tuner.storage.ros_reader import SECTION, read_sections
from bo_tuner.storage.ros_sections import Section, Source, sources
from bo_tuner.storage.ros_values import Single, read_value
from bo_tuner.study.strict_yaml import LONGEST_LINE

_OTHER_TRUTH = {
    a: b
    for one, other in (("yes", "no"), ("true", "false"), ("on", "off"), ("y", "n"))
    for make in (str.lower, str.title, str.upper)
    for a, b in ((make(one), make(other)), (make(other), make(one)))
}
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
"""Text that needs no quotes anywhere, if it is not taken for something else."""

Values = Single | list[Single]


@dataclass
class _Changes:
    """What is to be done in a file.

    Attributes
    ----------
    replaced
        New texts by the place of the old one: start and end, in characters.
    expected
        What ROS is to read then, by section and parameter, in the order of the file.
    """

    replaced: dict[tuple[int, int], str] = field(default_factory=dict)
    expected: dict[str, dict[str, Values]] = field(default_factory=dict)

    def insert(self, at: int, text: str) -> None:
        """Put a text at a place, behind what is to be put there already."""
        self.replaced[at, at] = self.replaced.get((at, at), "") + text


def with_values(text: str, values: NodeValues) -> str:
    """Return the text of a parameter file with other values.

    A value changes where ROS takes it from. Where that is a wildcard that other nodes share, and
    where the file has no such parameter, it is added to the node's own section behind that, or
    to a new one at the end.
    """
    sections = read_sections(text)
    changes = _Changes(expected={section.name: section.values for section in sections})
    wanted: dict[str, dict[str, Values]] = {}
    for node, of_node in values.items():
        if not any(section.is_of(node) for section in sections):
            raise StudyError(f"says nothing of the node {node}")
        now = sources(sections, node)
        new = {name: _values(value) for name, value in of_node.items()}
        wanted[node] = {name: source.written.value for name, source in now.items()} | new
        added: dict[str, Values] = {}
        for name, value in new.items():
            source = now.get(name)
            if source is None or _is_shared(source.section, node, sections, values):
                if source is None or not _same(source.written.value, value):
                    added[name] = value
            else:
                _replace(text, source, value, changes)
        if added:
            behind = [sections.index(now[name].section) for name in added if name in now]
            _add(text, node, added, sections, max(behind, default=-1), changes)
    edited = text
    for (start, end), new_text in sorted(changes.replaced.items(), reverse=True):
        edited = f"{edited[:start]}{new_text}{edited[end:]}"
    _check(edited, changes, wanted)
    return edited


def _check(text: str, changes: _Changes, wanted: Mapping[str, Mapping[str, Values]]) -> None:
    problem = "cannot be changed by itself, since ROS would read other values from it"
    try:
        sections = read_sections(text)
    except StudyError as error:
        raise StudyError("cannot be changed by itself, since ROS would refuse it") from error
    actual = {section.name: section.values for section in sections}
    if list(actual) != list(changes.expected) or not all(
        _same_all(actual[name], values) for name, values in changes.expected.items()
    ):
        raise StudyError(problem)
    for node, values in wanted.items():
        now = {name: source.written.value for name, source in sources(sections, node).items()}
        if not _same_all(now, values):
            raise StudyError(f"{problem}: of {node}")


def _is_shared(section: Section, node: str, sections: list[Section], values: NodeValues) -> bool:
    """Return whether other nodes than one take values from a section, too, or may."""
    if not section.is_wildcard:
        return False
    name = section.pattern.rpartition("/")[2]
    if "*" in name or any(section.is_of(other) for other in values if other != node):
        return True
    others = [other for other in sections if not other.is_of(node)]
    return any(
        other.pattern.rpartition("/")[2] in (name, "*", "**")
        if other.is_wildcard
        else section.is_of(other.pattern)
        for other in others
    )


def _replace(text: str, source: Source, value: Values, changes: _Changes) -> None:
    """Replace a value where it stands."""
    current, name = source.written, source.setting.name
    if _same(current.value, value):
        return
    changes.expected[source.section.name][name] = value
    if current.is_list != isinstance(value, list):
        expected = "a single value" if current.is_list else "a list"
        raise StudyError(f"{name}: expected {expected}, as the node has", line=source.line)
    new = value if isinstance(value, list) else [value]
    if len(new) == len(current.items):
        for item, single in zip(current.items, new, strict=True):
            if _same(item.value, single):
                continue
            if item.style in ("|", ">"):
                raise StudyError(f"{name}: expected its text on one line", line=item.line)
            like = text[item.start : item.end]
            changes.replaced[item.start, item.end] = _written(single, like, item.style)
    elif current.span is not None:
        style = current.items[0].style if current.items else ""
        changes.replaced[current.span] = _written(new, style=style)
    else:
        raise StudyError(
            f"{name}: expected {len(new)} items, found {len(current.items)}", line=source.line
        )


def _add(
    text: str,
    node: str,
    added: Mapping[str, Values],
    sections: list[Section],
    behind: int,
    changes: _Changes,
) -> None:
    """Add parameters of a node behind one of the sections."""
    own = [s for s in sections[max(behind, 0) :] if s.pattern == node and s.end]
    break_ = "\r\n" if "\r\n" in text else "\n"
    pairs = [f"{_text(name, '')}: {_written(value)}" for name, value in added.items()]
    if not own:
        known = {section.name for section in sections}
        name = node if node not in known else node.removeprefix("/")
        if name in known:
            raise StudyError(f"has a wildcard behind {node}; write a section behind that first")
        changes.expected[name] = dict(added)
        at = len(text)
        before = changes.replaced.get((at, at), text)
        start = "" if before.endswith("\n") else break_
        lines = [f"{name}:", f"  {SECTION}:", *(f"    {pair}" for pair in pairs), ""]
        changes.insert(at, start + break_.join(lines))
        return
    section = own[-1]
    changes.expected[section.name] |= added
    if section.in_braces:
        changes.insert(section.end, "".join(f", {pair}" for pair in pairs))
        return
    new = break_.join(f"{' ' * (section.column or 0)}{pair}" for pair in pairs)
    # A text in a block ends with its line.
    line_end = text.find("\n", section.end - 1)
    if line_end < 0:
        changes.insert(len(text), f"{break_}{new}")
    else:
        changes.insert(line_end + 1, f"{new}{break_}")


def _written(value: Values, like: str = "", style: str = "") -> str:
    """Return a value as it is written after the habits of another one: its text and its quotes."""
    if isinstance(value, list):
        return f"[{', '.join(_written(item, like, style) for item in value)}]"
    if isinstance(value, bool):
        # In place of a truth value it is the other one, or it would not be written.
        return _OTHER_TRUTH.get(like, "true" if value else "false")
    if isinstance(value, str):
        return _text(value, style)
    return str(yaml.representer.SafeRepresenter().represent_data(value).value)


def _text(text: str, style: str) -> str:
    is_plain = _PLAIN.fullmatch(text) and read_value(text) == yaml.safe_load(text) == text
    if is_plain and not style:
        return text
    if style == '"' or not text.isprintable():
        node = yaml.ScalarNode("tag:yaml.org,2002:str", text, style='"')
        return str(yaml.serialize(node, width=LONGEST_LINE, allow_unicode=True)).strip()
    return "'{}'".format(text.replace("'", "''"))


def _values(value: object) -> Values:
    plain: Values = list(value) if isinstance(value, (list, tuple)) else value  # type: ignore[assignment]
    return plain


def _same(one: Values, other: Values) -> bool:
    """Return whether two values are equal and of one type: 1 and 1.0 are not."""
    return repr(one) == repr(other)


def _same_all(one: Mapping[str, Values], other: Mapping[str, Values]) -> bool:
    return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
