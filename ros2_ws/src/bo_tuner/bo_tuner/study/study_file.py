"""Study files: from YAML to a checked `Study`, and back."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings, under
from bo_tuner.codec.reading import arguments, classes_in, entries, fields_of, keys_of, read
from bo_tuner.codec.writing import to_file
from bo_tuner.errors import BackendError, KeyPath, StudyError
from bo_tuner.interruption import content_of_file
from bo_tuner.package_files import config_directory
from bo_tuner.study import strict_yaml
from bo_tuner.study.descriptors import Descriptions, complete, incomplete
from bo_tuner.study.function_study import with_function
from bo_tuner.study.metrics import COMPUTED, metric_expression, metric_kind
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.playing import with_bags
from bo_tuner.study.references import check_names
from bo_tuner.study.relative_limits import written_out
from bo_tuner.study.study import BY_NAME, Study

COST = "cost"
"""Name of the metric for an objective that is written as an expression."""
MAX_BYTES = 1_000_000
LONGEST_PROBLEM = 1000

_SECTIONS = {item.name: item for item in fields_of(Study)}
_NAMED = [name for name, item in _SECTIONS.items() if BY_NAME in get_args(item.hint)]


def shipped_studies() -> list[str]:
    """Return the names of the studies that come with the package."""
    return sorted(path.stem for path in (config_directory() / "studies").glob("*.yaml"))


def shipped_nodes() -> list[NodeSpec]:
    """Return the nodes of all shipped studies, without reading their other sections."""
    nodes: list[NodeSpec] = []
    for name in shipped_studies():
        path = config_directory() / "studies" / f"{name}.yaml"
        content = arguments(Study, strict_yaml.parse(read_text(path, path.name)).value)
        nodes += read(Mapping[str, NodeSpec], content["nodes"]).values()
    return nodes


Describe = Callable[[Mapping[str, str]], Descriptions]
"""Asks nodes, ROS names by keys in the study, for all their parameters."""


def load_study(
    name_or_path: str | Path,
    describe: Describe | None = None,
    *,
    of_function: bool = False,
) -> Study:
    """Read a study.

    Parameters
    ----------
    name_or_path : str or pathlib.Path
        Name of a shipped study, or the path of a file: text with a suffix or a separator.
    describe : callable, optional
        Asks the nodes for what the file leaves open of their parameters; without it, nothing may
        be left open.
    of_function : bool
        Whether a file without nodes describes a study of a function, which becomes its only node.

    Returns
    -------
    Study
        The checked study.

    Raises
    ------
    StudyError
        If there is no such study, the file cannot be read, or it violates a rule. One line with
        the file, the line, the key path, what was expected and what was found; ``others`` are the
        errors of other parts, in the order of the file.
    """
    if isinstance(name_or_path, str) and not is_path(name_or_path):
        names = shipped_studies()
        if name_or_path not in names:
            raise StudyError(
                f"unknown study {checks.quoted(name_or_path)}; shipped are {', '.join(names)}; "
                "write a path with its suffix, such as ./mine.yaml"
            )
        path = config_directory() / "studies" / f"{name_or_path}.yaml"
        return parse_study(read_text(path, path.name), path.name)
    source = str(name_or_path)
    text = read_text(Path(name_or_path), source)
    folder = Path(name_or_path).resolve().parent
    study = parse_study(text, source, describe, of_function=of_function, folder=folder)
    return _in_folder(study, folder, source)


def _in_folder(study: Study, folder: Path, source: str) -> Study:
    """Return a study with the full path of its own folder; `folder` has its file.

    Raises
    ------
    StudyError
        If a file there with a reference over time cannot be read.
    """
    own = str((folder / study.folder).resolve()) if study.needs_folder else study.folder
    try:
        with under("run"):
            run = study.run and study.run.read_files(own)
    except StudyError as error:
        problems = [each.located(source, None) for each in (error, *error.others)]
        raise problems[0].with_others(problems[1:]) from None
    return dataclasses.replace(study, folder=own, run=run)


def parse_study(
    text: str,
    source: str = "study",
    describe: Describe | None = None,
    *,
    of_function: bool = False,
    folder: Path | None = None,
) -> Study:
    """Return the study that a YAML text describes; `source` names it in errors.

    `describe` asks nodes for what the text leaves open of their parameters. With `of_function` a
    text without nodes describes a study of a function. Bags are looked for in a `folder`.

    Raises
    ------
    StudyError
        If the text is not valid YAML or violates a rule.
    """
    lines: Mapping[KeyPath, int] = {}

    def located(error: StudyError) -> StudyError:
        line, path = error.line, error.path
        while line is None and path:
            line = lines.get(path)
            path = path[:-1]
        # A problem may list names from the file, which can be long.
        problem = error.problem
        if len(problem) > LONGEST_PROBLEM:
            problem = f"{problem[: LONGEST_PROBLEM - 3]}..."
        return StudyError(problem, error.path, source, line)

    try:
        document = strict_yaml.parse(text)
        lines = document.lines
        if describe is not None and (open_nodes := incomplete(document.value)):
            _check_what_is_given(document.value, open_nodes)
            _fill_in(document.value, open_nodes, describe)
        completed = with_function(document.value) if of_function else document.value
        return study_from_mapping(with_bags(completed, folder))
    except StudyError as error:
        problems = [located(each) for each in (error, *error.others)]
        # An error on a key that is missing has no line, and comes last.
        first, *others = sorted(problems, key=lambda each: each.line or math.inf)
        raise first.with_others(others) from None


def study_from_mapping(mapping: object) -> Study:
    """Return the study for the dictionaries and lists of a study file.

    Raises
    ------
    StudyError
        If they violate a rule; carries the key path to the value, and the errors of other parts.
    """
    findings = Findings()
    made = _parts(mapping, findings)
    findings.check()
    return Study(**made)


def _parts(mapping: object, findings: Findings) -> dict[str, Any]:
    """Return what a study is made of; what is wrong with a part goes to `findings`."""
    mapping = checks.mapping(mapping)
    with findings.under():
        arguments(Study, mapping)
    values = {key: item for key, item in mapping.items() if key in _SECTIONS}
    size = len(findings)
    with findings.under("objective"):
        values |= _objective_of_text(values)
    if len(findings) > size:
        # Its error is among the findings already.
        del values["objective"]
    values |= written_out(values, findings)
    made = dict(values)
    for key, item in _SECTIONS.items():
        if key not in values or not classes_in(item.hint):
            continue
        del made[key]
        inner = Findings()
        if key in _NAMED:
            made[key] = entries(item.hint, values[key], inner)
        else:
            with inner.under():
                made[key] = item.read(values[key], "")
        with findings.under(key):
            inner.check()
    if findings:
        # Errors in references are reported together with those in the parts.
        check_names(made, _names(values), findings)
    return made


def _names(values: Mapping[str, object]) -> dict[str, list[str]]:
    """Return by section the names of the parts in a study file, as far as it has such a section."""
    # What a run that was refused may use is not known.
    by_section: dict[str, list[str]] = {"run": []} if "run" in values else {}
    for key in _NAMED:
        section = values.get(key, None if _SECTIONS[key].is_required else {})
        if isinstance(section, dict):
            by_section[key] = [name for name in section if isinstance(name, str)]
    return by_section


def _objective_of_text(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections that a text objective is short for; none if the objective is no text."""
    given, metrics = values.get("objective"), values.get("metrics")
    if not isinstance(given, str) or not isinstance(metrics, dict):
        return {}
    if given in metrics or given.isidentifier():
        return {"objective": {"metric": given}}
    measured = (name for name, item in metrics.items() if metric_kind(item) not in COMPUTED)
    metric_expression(given, [name for name in measured if isinstance(name, str)])
    if COST in metrics:
        raise StudyError(
            f"an expression is the metric '{COST}', which there is already; write it as that "
            "metric's expression"
        )
    return {"objective": {"metric": COST}, "metrics": metrics | {COST: {"expression": given}}}


def study_to_mapping(study: Study) -> dict[str, object]:
    """Return the dictionaries and lists of a study file that describes `study`."""
    mapping: dict[str, object] = to_file(study)
    if not study.start:
        # Here an empty list differs from a missing key, which means the default.
        mapping["start"] = []
    return mapping


def study_to_yaml(study: Study) -> str:
    """Return the text of a study file, which `parse_study` reads as an equal study."""
    return strict_yaml.dump(study_to_mapping(study))


def _check_what_is_given(mapping: object, nodes: Mapping[str, Sequence[str]]) -> None:
    """Raise what is wrong whatever the nodes say: a misspelt key needs no node to be found."""
    left_open = {name for names in nodes.values() for name in names}
    keys = {item.name for item in keys_of(Parameter)}

    def may_be_filled_in(path: KeyPath) -> bool:
        return path[:1] == ("parameters",) and path[1] in left_open and not set(path[2:3]) - keys

    findings = Findings()
    _parts(mapping, findings)
    findings.check(lambda error: not may_be_filled_in(error.path))


def _fill_in(mapping: object, nodes: Mapping[str, Sequence[str]], describe: Describe) -> None:
    """Let nodes say what the file leaves open; other errors are found later."""
    specs = mapping.get("nodes") if isinstance(mapping, dict) else None
    if not isinstance(mapping, dict) or not isinstance(specs, dict):
        return
    names = {}
    for key, parameters in nodes.items():
        checks.reference(key, "node", specs, "parameters", parameters[0], "node")
        spec = specs[key]
        if not isinstance(spec, dict) or not isinstance(spec.get("node"), str):
            return
        names[key] = checks.node_name(spec["node"], "nodes", key, "node")
    try:
        described = describe(names)
    except BackendError as error:
        started = [key for key in nodes if read(NodeSpec, specs[key], name=key).is_started]
        if not started:
            raise
        key, open_ = started[0], nodes[started[0]]
        raise StudyError(
            f"{error}; a study that starts {key} has to say type, bounds and default of "
            f"{', '.join(open_)}, and of an item of an array the array, under nodes.{key}."
            "parameters; or start the node first, and it is asked",
            ("parameters", open_[0]),
        ) from None
    complete(mapping, described)


def is_path(text: str) -> bool:
    """Whether a text is a path, with a suffix or separator, and not the name of a shipped study."""
    return "/" in text or "\\" in text or Path(text).suffix != ""


def read_text(path: Path, source: str) -> str:
    """Read a file of the user; errors call it `source`.

    Raises
    ------
    StudyError
        If it cannot be read, is too large, or is no UTF-8 text.
    """
    try:
        content = content_of_file(path, MAX_BYTES)
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        raise StudyError(problem, source=source) from None
    except ValueError as error:
        # The path has a null character.
        raise StudyError(f"cannot be read: {error}", source=repr(source)) from None
    if len(content) > MAX_BYTES:
        raise StudyError("expected a file of at most 1 MB", source=source)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise StudyError("expected UTF-8 text", source=source, line=line) from None
