"""Experiment files: from YAML to a checked `Experiment`."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from bo_tuner.codec import checks
from bo_tuner.codec.reading import arguments, read
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.package_files import config_directory
from bo_tuner.study import strict_yaml
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import (
    is_path,
    load_study,
    read_text,
    shipped_studies,
    study_from_mapping,
    study_to_mapping,
)
from tuning_benchmark.experiments.experiment import (
    Calibration,
    Case,
    Cost,
    Experiment,
    Point,
    Row,
    SurrogateFigure,
)
from tuning_benchmark.experiments.optima import read_optima
from tuning_benchmark.problems.closed_form import ClosedForm
from tuning_benchmark.problems.two_basins import TwoBasins

T = TypeVar("T")

PROBLEMS = {"closed_form": ClosedForm, "two_basins": TwoBasins}
"""Problems in closed form, by the key `problem` of their settings."""


def shipped_experiments() -> list[str]:
    """Return the names of the experiments that come with the package."""
    return sorted(
        path.stem for path in (config_directory("tuning_benchmark") / "experiments").glob("*.yaml")
    )


def load_experiment(name_or_path: str) -> Experiment:
    """Read an experiment.

    Parameters
    ----------
    name_or_path
        Name of a shipped experiment, or the path of a file: text with a suffix or a separator.

    Raises
    ------
    StudyError
        If there is no such experiment, the file cannot be read, or it breaks a rule. One line
        with the file, the line, the path of keys, what was expected and what was found.
    """
    path = Path(name_or_path)
    if not is_path(name_or_path):
        names = shipped_experiments()
        if name_or_path not in names:
            raise StudyError(
                f"unknown experiment {checks.quoted(name_or_path)}; shipped are "
                f"{', '.join(names)}; write a path with its suffix, such as ./mine.yaml"
            )
        path = config_directory("tuning_benchmark") / "experiments" / f"{name_or_path}.yaml"
    text = read_text(path, name_or_path)
    lines: Mapping[KeyPath, int] = {}
    try:
        document = strict_yaml.parse(text)
        lines = document.lines
        return _experiment(document.value, path.parent)
    except StudyError as error:
        if error.source:
            # A study that the experiment names; its error has the place in its own file.
            raise
        line, where = error.line, error.path
        while line is None and where:
            line = lines.get(where)
            where = where[:-1]
        raise error.located(path.name, line) from None


def _experiment(value: object, folder: Path) -> Experiment:
    given = dict(_mapping(value))
    optima = {}
    if "truth" in given:
        optima = read_optima(folder / checks.text(given.pop("truth"), "truth"))
    fields = arguments(Experiment, given, skip=("optima",), also=("truth",))
    fields["cases"] = _named("cases", fields, lambda name, item: _case(name, item, folder))
    if "calibration" in fields:
        with _under("calibration"):
            fields["calibration"] = _calibration(fields["calibration"], folder)
    if "cost" in fields:
        with _under("cost"):
            fields["cost"] = _cost(fields["cost"])
    return Experiment(optima=optima, **fields)


def _case(name: str, value: object, folder: Path) -> Case:
    given = dict(_mapping(value))
    changes = given.pop("changes", {})
    fields = arguments(Case, given, skip=("name",), also=("changes",))
    fields["study"] = _study(fields["study"], folder)
    with _under("changes"):
        if _mapping(changes):
            fields["study"] = _changed(fields["study"], changes)
    fields["rows"] = _named("rows", fields, _row)
    if "surrogates" in fields:
        with _under("surrogates"):
            fields["surrogates"] = read(SurrogateFigure, fields["surrogates"])
    if "points" in fields:
        fields["points"] = _named("points", fields, lambda _, item: read(Point, item))
    return Case(name=name, **fields)


def _row(name: str, value: object) -> Row:
    row: Row = read(Row, value, name=name)
    return row


def _calibration(value: object, folder: Path) -> Calibration:
    fields = arguments(Calibration, value)
    fields["study"] = _study(fields["study"], folder)
    fields["grid"] = _named("grid", fields, lambda _, v: checks.sequence(v, "a list of values"))
    return Calibration(**fields)


def _cost(value: object) -> Cost:
    fields = arguments(Cost, value)
    for name in ("dimensions", "trials"):
        if name in fields:
            fields[name] = checks.sequence(fields[name], "a list of integers", name)
    return Cost(**fields)


def _study(value: object, folder: Path) -> Study:
    """Read a study, shipped or beside the experiment file, or make that of a closed form."""
    if isinstance(value, dict):
        with _under("study"):
            settings = dict(value)
            problem = settings.pop("problem", "closed_form")
            checks.choice(problem, tuple(PROBLEMS), "problem")
            made: Study = read(PROBLEMS[problem], settings).study()
            return made
    name = checks.text(value, "study")
    study = load_study(name if name in shipped_studies() else folder / name)
    # The records of a campaign are the same on all machines.
    return dataclasses.replace(study, folder="")


def _changed(study: Study, changes: Mapping[str, Any]) -> Study:
    """Return a study with other values at paths of keys ``section.name``; null removes a key."""
    content: dict[str, Any] = study_to_mapping(study)
    for path, value in changes.items():
        *parents, key = path.split(".")
        part: Any = content
        for parent in parents:
            part = part.get(parent) if isinstance(part, dict) else None
        if not isinstance(part, dict):
            raise StudyError("expected a path of keys of the study", (path,))
        if value is None:
            part.pop(key, None)
        else:
            part[key] = value
    return study_from_mapping(content)


def _named(key: str, fields: Mapping[str, Any], build: Callable[[str, object], T]) -> dict[str, T]:
    """Build the items of the mapping in field `key`."""
    items: dict[str, T] = {}
    with _under(key):
        for name, item in _mapping(fields[key]).items():
            with _under(name):
                items[name] = build(name, item)
    return items


@contextmanager
def _under(key: str) -> Iterator[None]:
    """Put `key` in front of the path of an error from within, unless it is in another file."""
    try:
        yield
    except StudyError as error:
        raise error if error.source else error.under(key) from None


def _mapping(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise StudyError(f"expected a mapping, found {checks.show(value)}")
    return value
