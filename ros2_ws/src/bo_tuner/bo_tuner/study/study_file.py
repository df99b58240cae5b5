"""Study files: from YAML to a checked `Study`, and back."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Findings, arguments, build, is_required, under
from bo_tuner.errors import BackendError, KeyPath, StudyError
from bo_tuner.interruption import content_of_file
from bo_tuner.package_files import config_directory
from bo_tuner.study import strict_yaml
from bo_tuner.study.budget import Budget, CertificateRequirement
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.descriptors import Descriptions, complete, incomplete
from bo_tuner.study.distributions import DISTRIBUTIONS, Distribution
from bo_tuner.study.function_study import with_function
from bo_tuner.study.guarding import Guarding, build_guarding
from bo_tuner.study.metrics import COMPUTED, ReportedMetric, metric_expression, metric_kind
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.park import Park
from bo_tuner.study.parts import ContextVariable, Objective, SeedParameter, Trigger
from bo_tuner.study.references import check_names
from bo_tuner.study.relative_limits import written_out
from bo_tuner.study.run import Run, build_run
from bo_tuner.study.safe_search import SafeSearch, build_safe_search
from bo_tuner.study.signals import Signal
from bo_tuner.study.study import Study

COST = "cost"
"""Name of the metric for an objective that is written as an expression."""
MAX_BYTES = 1_000_000
LONGEST_PROBLEM = 1000

# Sections that may be, in whole or in part, a single word.
_BUILDERS: dict[type[Any], Callable[[object], Any]] = {
    Run: build_run,
    Guarding: build_guarding,
    SafeSearch: build_safe_search,
}
# Sections with one object, and sections with objects by name.
_SINGLE: dict[str, type[Any]] = {
    "trigger": Trigger,
    "seed_parameter": SeedParameter,
    "objective": Objective,
    "budget": Budget,
    "run": Run,
    "park": Park,
    "guard": Guarding,
    "safe_search": SafeSearch,
    "certificate": CertificateRequirement,
}
_NAMED: dict[str, type[Any]] = {
    "nodes": NodeSpec,
    "parameters": Parameter,
    "contexts": ContextVariable,
    "signals": Signal,
    "metrics": ReportedMetric,
    "constraints": Constraint,
}
_SECTIONS = [field.name for field in dataclasses.fields(Study)]


def shipped_studies() -> list[str]:
    """Return the names of the studies that come with the package."""
    return sorted(path.stem for path in (config_directory() / "studies").glob("*.yaml"))


def shipped_nodes() -> list[NodeSpec]:
    """Return the nodes of all shipped studies, without reading their other sections."""
    nodes: list[NodeSpec] = []
    for name in shipped_studies():
        path = config_directory() / "studies" / f"{name}.yaml"
        content = arguments(Study, strict_yaml.parse(read_text(path, path.name)).value)
        findings = Findings()
        nodes += _build_named("nodes", NodeSpec, content["nodes"], findings).values()
        findings.check()
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
    study = parse_study(text, source, describe, of_function=of_function)
    return _in_folder(study, Path(name_or_path).resolve().parent, source)


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
) -> Study:
    """Return the study that a YAML text describes; `source` names it in errors.

    `describe` asks nodes for what the text leaves open of their parameters. With `of_function` a
    text without nodes describes a study of a function.

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
        return study_from_mapping(completed)
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
    for key, cls in _SINGLE.items():
        if key in values:
            del made[key]
            with findings.under(key):
                builder = _BUILDERS.get(cls)
                made[key] = builder(values[key]) if builder else build(cls, values[key])
    if "further_objectives" in values:
        del made["further_objectives"]
        with findings.under():
            made["further_objectives"] = _build_objectives(values["further_objectives"])
    for key, cls in _NAMED.items():
        if key in values:
            made[key] = _build_named(key, cls, values[key], findings)
    if findings:
        # Errors in references are reported together with those in the parts.
        check_names(made, _names(values), findings)
    return made


def _names(values: Mapping[str, object]) -> dict[str, list[str]]:
    """Return by section the names of the parts in a study file, as far as it has such a section."""
    optional = {field.name for field in dataclasses.fields(Study) if not is_required(field)}
    # What a run that was refused may use is not known.
    by_section: dict[str, list[str]] = {"run": []} if "run" in values else {}
    for key in _NAMED:
        section = values.get(key, {} if key in optional else None)
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


def _build_objectives(value: object) -> tuple[Objective, ...]:
    objectives = []
    for index, item in enumerate(
        checks.sequence(value, "a list of objectives", "further_objectives")
    ):
        with under("further_objectives", index):
            objectives.append(build(Objective, item))
    return tuple(objectives)


def study_to_mapping(study: Study) -> dict[str, object]:
    """Return the dictionaries and lists of a study file that describes `study`."""
    mapping = _plain_fields(study)
    for key in _NAMED:
        items = getattr(study, key)
        if items:
            mapping[key] = {name: _plain_part(item) for name, item in items.items()}
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
    keys = {field.name for field in dataclasses.fields(Parameter)}

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
        started = [key for key in nodes if build(NodeSpec, specs[key], name=key).is_started]
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


def _build_named(section: str, cls: type[Any], value: object, findings: Findings) -> dict[str, Any]:
    """Return the parts of a section by name; what is wrong with others goes to `findings`."""
    items: dict[str, Any] = {}
    with findings.under(section):
        if not isinstance(value, dict):
            shown = checks.show(value)
            raise StudyError(f"expected a mapping of names, {{}} for none, found {shown}")
        for name, fields in value.items():
            if not isinstance(name, str):
                raise StudyError(f"expected a name, found {checks.show(name)}")
            with findings.under(section, name):
                if cls is ContextVariable:
                    items[name] = _build_context(name, fields)
                elif cls is ReportedMetric:
                    items[name] = build(metric_kind(fields), fields, name=name)
                else:
                    items[name] = build(cls, fields, name=name)
    return items


def _build_context(name: str, value: object) -> ContextVariable:
    """Separate the keys of the variable from those of its distribution, on the same level."""
    value = checks.mapping(value)
    if "distribution" not in value:
        raise StudyError(f"missing; expected one of {', '.join(DISTRIBUTIONS)}", ("distribution",))
    kind = checks.choice(value["distribution"], tuple(DISTRIBUTIONS), "distribution")
    own = [field.name for field in dataclasses.fields(ContextVariable) if field.name != "name"]
    cls = DISTRIBUTIONS[kind]
    shape = {key: item for key, item in value.items() if key not in own}
    distribution = cls(**arguments(cls, shape, also=own))
    variable = {key: item for key, item in value.items() if key in own and key != "distribution"}
    return build(ContextVariable, variable, name=name, distribution=distribution)


def _plain_part(part: Any) -> dict[str, object]:
    fields = _plain_fields(part)
    # The part has its name as its key.
    del fields["name"]
    if isinstance(part, ContextVariable):
        distribution: Distribution = part.distribution
        fields["distribution"] = distribution.kind
        fields |= _plain_fields(distribution)
    return fields


def _plain_fields(settings: Any) -> dict[str, Any]:
    """Return the fields that are not empty, with lists for tuples."""
    plain = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        # An empty text may be one of the choices of a parameter.
        if value is None or value in ((), {}) or (value == "" and field.default == ""):
            continue
        plain[field.name] = _plain(value)
    return plain


def _plain(value: object) -> object:
    """Return parts within parts as mappings, and tuples as lists."""
    if dataclasses.is_dataclass(value):
        return _plain_fields(value)
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value
