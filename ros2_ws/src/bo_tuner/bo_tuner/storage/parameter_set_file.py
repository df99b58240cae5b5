"""Parameter sets that a user knows, from a YAML file."""

from collections.abc import Mapping
from pathlib import Path

from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.storage.parameter_file import SECTION
from bo_tuner.study import checks, strict_yaml
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import read_text
from bo_tuner.trials import Value


def read_parameter_set(path: Path, study: Study) -> dict[str, Value]:
    """Return the values of the study's parameters that a file holds, by their names in the study.

    Parameters
    ----------
    path
        A file of values by name, ``gain: 0.4``, or a parameter file of ROS nodes. Of the latter
        everything else that the nodes have is ignored. A node counts in any namespace, unless the
        study names that.
    study
        The study.

    Raises
    ------
    StudyError
        If it is no such file, or is not a parameter set of the study. One line.
    """
    source = str(path)
    lines: Mapping[KeyPath, int] = {}
    try:
        document = strict_yaml.parse(read_text(path, source))
        lines, found = document.lines, document.value
        if not isinstance(found, dict) or not found:
            raise StudyError(f"expected values by name, found {checks.show(found)}")
        of_nodes = any(isinstance(item, dict) and SECTION in item for item in found.values())
        values = _of_nodes(found, study) if of_nodes else found
        for name in values:
            checks.reference(name, "parameter", study.parameters, name)
        if not values:
            raise StudyError("has none of the study's parameters")
        complete = study.complete_set(values)
    except StudyError as error:
        line = lines.get(error.path) if error.line is None else error.line
        raise error.located(source, line) from None
    return {name: complete[name] for name in values}


def _of_nodes(document: Mapping[str, object], study: Study) -> dict[str, Value]:
    values: dict[str, Value] = {}
    for name, item in study.parameters.items():
        found: dict[int, dict[str, Value]] = {}
        for key, section in document.items():
            given = section.get(SECTION) if isinstance(section, dict) else None
            match = _match(key, study.nodes[item.node].node)
            if match is None or not isinstance(given, dict):
                continue
            value = _nested(given, item.array or item.parameter)
            if item.array:
                items = value if isinstance(value, list) else []
                value = items[item.item] if item.item < len(items) else None
            if isinstance(value, bool | int | float | str):
                found.setdefault(match, {})[key] = value
        if not found:
            continue
        closest = found[max(found)]
        if len({(type(value), value) for value in closest.values()}) > 1:
            raise StudyError(f"has several values: of {' and of '.join(closest)}", (name,))
        values[name] = next(iter(closest.values()))
    return values


def _match(key: str, node: str) -> int | None:
    """Return how well the key of a section names a node, more is better; None if it does not."""
    parts, wanted = key.strip("/").split("/"), node.strip("/").split("/")
    if parts[-1] == "**":
        # The namespace of the tuner may stand ahead of that in the study.
        above = len(parts) - 1
        return None if above and len(wanted) > 1 and parts[:above] != wanted[:above] else 0
    of_any_namespace = parts[0] == "**"
    parts = parts[1:] if of_any_namespace else parts
    shared = min(len(parts), len(wanted))
    if parts[-shared:] != wanted[-shared:]:
        return None
    return 2 if len(parts) >= len(wanted) and not of_any_namespace else 1


def _nested(values: Mapping[str, object], name: str) -> object:
    """Return a parameter, whose dots may be levels of the file; None if it is not there."""
    if name in values:
        return values[name]
    first, _, rest = name.partition(".")
    below = values.get(first)
    return _nested(below, rest) if rest and isinstance(below, dict) else None
