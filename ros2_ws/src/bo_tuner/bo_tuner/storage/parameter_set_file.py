"""Parameter sets that a user knows, from a YAML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.storage.ros_reader import is_parameter_file, read_sections
from bo_tuner.storage.ros_sections import Section, full_names, sources
from bo_tuner.study import strict_yaml
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import read_text
from bo_tuner.trials import Value


def read_parameter_set(path: Path, study: Study, namespace: str = "") -> dict[str, Value]:
    """Return the values of a study's parameters that a file holds, by their names there."""
    source = str(path)
    lines: Mapping[KeyPath, int] = {}
    try:
        text = read_text(path, source)
        if is_parameter_file(text):
            values, lines = _of_nodes(read_sections(text), study, namespace)
            # A node has also what is not active.
            values = study.search_space().active(values)
        else:
            document = strict_yaml.parse(text)
            lines, content = document.lines, document.value
            if not isinstance(content, dict) or not content:
                raise StudyError(f"expected values by name, found {checks.show(content)}")
            values = content
        for name in values:
            checks.reference(name, "parameter", study.parameters, name)
        if not values:
            raise StudyError("has none of the study's parameters")
        complete = study.complete_set(values)
    except StudyError as error:
        line = lines.get(error.path) if error.line is None else error.line
        raise error.located(source, line) from None
    return {name: complete[name] for name in values}


def _of_nodes(
    sections: list[Section], study: Study, namespace: str
) -> tuple[dict[str, Value], dict[KeyPath, int]]:
    """Return the values by parameter of the study, and the line of each."""
    values: dict[str, Value] = {}
    lines: dict[KeyPath, int] = {}
    for item in study.parameters_of_nodes:
        name = item.name
        by_node: dict[str, Value] = {}
        for node in full_names(sections, study.nodes[item.node].node, namespace):
            source = sources(sections, node).get(item.array or item.parameter)
            if source is None or source.written.is_list != bool(item.array or item.is_list):
                continue
            at = item.item if item.array else 0
            items = source.written.items
            if at < len(items):
                lines[(name,)] = items[at].line
                value: Any = [each.value for each in items] if item.is_list else items[at].value
                by_node[node] = item.in_trials(value, name)
        if len({(type(value), value) for value in by_node.values()}) > 1:
            raise StudyError(f"has several values: of {' and of '.join(by_node)}", (name,))
        if by_node:
            values[name] = next(iter(by_node.values()))
    return values, lines
