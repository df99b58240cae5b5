"""What a parameter file says of nodes, where it stands, and which of it a node takes."""

import re
from dataclasses import dataclass, field

from bo_tuner.storage.ros_values import Single

_KINDS = (bool, int, float, str)
"""Types in the order in which they count where a parameter has values of several types."""


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
class WrittenValue:
    """A value that a file has of a parameter: of one type, single or a list.

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
    written
        Its values in the file, by whether they are a list and by type.
    """

    name: str
    written: dict[tuple[bool, type], WrittenValue] = field(default_factory=dict)

    @property
    def counts(self) -> WrittenValue | None:
        """The value that ROS takes of several; None if there is none."""
        for is_list in (False, True):
            for kind in (*_KINDS, type(None)):
                if (is_list, kind) in self.written:
                    return self.written[is_list, kind]
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
        return {name: counts.value for name, counts in every if counts is not None}


@dataclass(frozen=True)
class Source:
    """Where a node's parameter comes from."""

    section: Section
    setting: Setting
    written: WrittenValue

    @property
    def line(self) -> int | None:
        """The line of its value, from 1."""
        return self.written.items[0].line if self.written.items else None


def full_name(node: str, namespace: str) -> str:
    """Return the full name of a node that is named relative to a namespace, or in full."""
    if node.startswith("/"):
        return node
    return f"/{namespace.strip('/')}/{node}" if namespace.strip("/") else f"/{node}"


def full_names(sections: list[Section], node: str, namespace: str = "") -> list[str]:
    """Return the full names that a node may have in a file."""
    name = full_name(node, namespace)
    if node.startswith("/") or namespace or any(section.is_of(name) for section in sections):
        return [name]
    others = [s.pattern for s in sections if not s.is_wildcard and s.pattern.endswith(name)]
    return list(dict.fromkeys(others)) or [name]


def sources(sections: list[Section], node: str) -> dict[str, Source]:
    """Return where each parameter of a node comes from: of several sections the last."""
    by_name: dict[str, Source] = {}
    for section in sections:
        if section.is_of(node):
            for setting in section.settings:
                by_name.pop(setting.name, None)
                if (counts := setting.counts) is not None:
                    by_name[setting.name] = Source(section, setting, counts)
    return by_name
