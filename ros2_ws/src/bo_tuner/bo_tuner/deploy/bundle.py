"""The bundle of a run, ``RUN/deploy/``: the files to deploy its result and to roll it back.

Each file is written atomically, the provenance last; it has the SHA-256 of all others, so a
recipient can verify that the bundle is complete.
"""

import contextlib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.codec import checks
from bo_tuner.errors import OutputError, RunRecordError
from bo_tuner.evidence.certificate.store import evaluations_path, latest_certificate
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.verdict import as_mapping, notes_of_file
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.csv_tables import csv_text
from bo_tuner.storage.parameter_file import (
    NodeValues,
    all_values,
    from_yaml,
    node_values,
    sent_values,
    to_yaml,
)
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import LOGS, PREVIOUS_PARAMETERS, read_text
from bo_tuner.storage.run_folder import REPORT
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

DEPLOY = "deploy"
PARAMETERS = "parameters.yaml"
ROLLBACK = "rollback.yaml"
UNFINISHED = "unfinished.txt"
"""Is there while `apply` sets values, and stays if nodes may have some of them and not others."""
DIFFERENCE = "difference.csv"
PROVENANCE = "provenance.json"

CERTIFICATE, EVALUATIONS = "certificate.json", "certificate_evaluations.csv"

_DIGEST = "# sha256 of all that follows: "
"""Begins the first line of the rollback file, which is a comment for all other readers."""


@dataclass(frozen=True)
class Difference:
    """A parameter of a node with its present and its new value."""

    node: str
    parameter: str
    unit: str
    now: object
    new: object

    @property
    def equal(self) -> bool:
        """Whether the node has the new value, or that rounded to 32 bits."""
        return checks.holds(self.now, self.new)


def differences(study: Study, now: NodeValues, new: NodeValues) -> list[Difference]:
    """Return present and new values side by side; None for a value that a node does not have."""
    units = {
        (study.nodes[item.node].node, item.parameter): item.unit
        for item in study.parameters_of_nodes
    }
    return [
        Difference(node, name, units.get((node, name), ""), now.get(node, {}).get(name), value)
        for node, values in new.items()
        for name, value in values.items()
    ]


def result_of(record: RunRecord) -> Trial:
    """Return the trial that is the result of a run."""
    if record.summary is None:
        raise RunRecordError(
            f"{record.path}: has no result: it has not ended, or every trial failed"
        )
    if record.result is None:
        shown = checks.show(record.summary.get("trial"))
        raise RunRecordError(f"{record.path}: its summary names trial {shown}, not on record")
    return record.result


def write_bundle(record: RunRecord, rollback: NodeValues | None = None) -> Path:
    """Write or update the bundle of a run that has ended."""
    trial = result_of(record)
    tuned = node_values(record.study, trial.parameters)
    default = node_values(record.study, record.study.search_space().defaults)
    if rollback is not None:
        _check_restorable(rollback, record.study)
    folder = record.path / DEPLOY
    notes = [
        *notes_of_file(run_verdict(record), record.study),
        *sent_values(record.study, trial.parameters),
    ]
    files = {
        PARAMETERS: to_yaml(tuned, notes).encode(),
        DIFFERENCE: _table(differences(record.study, default, tuned)).encode(),
    }
    with writing(folder):
        folder.mkdir(exist_ok=True)
        for name, source in _copied(record, trial).items():
            if source is not None and source.is_file():
                files[name] = source.read_bytes()
            else:
                (folder / name).unlink(missing_ok=True)
        if REPORT in files:
            # Its links lead into the run folder, which is one level up from here.
            files[REPORT] = files[REPORT].replace(b'href="./', b'href="../')
        if rollback is not None or not (folder / ROLLBACK).exists():
            files[ROLLBACK] = _sealed(
                rollback or before_run(record) or all_values(record.study)
            ).encode()
        else:
            # What cannot be restored is left alone, and nothing vouches for it.
            with contextlib.suppress(RunRecordError):
                read_rollback(record)
                files[ROLLBACK] = (folder / ROLLBACK).read_bytes()
        files[PROVENANCE] = _provenance(record, trial, files).encode()
        for name, content in files.items():
            write_atomically(folder / name, content)
    return folder


def withdraw_bundle(folder: Path) -> None:
    """Remove the bundle in a run folder, but for what a rollback needs."""
    for name in (PROVENANCE, PARAMETERS, DIFFERENCE, CERTIFICATE, EVALUATIONS, REPORT):
        (folder / DEPLOY / name).unlink(missing_ok=True)


def _copied(record: RunRecord, trial: Trial) -> dict[str, Path | None]:
    """Return the files of the run that the bundle has too, by their names there."""
    certificate = None
    with contextlib.suppress(RunRecordError):
        certificate = latest_certificate(record, trial)
    return {
        CERTIFICATE: certificate,
        EVALUATIONS: None if certificate is None else evaluations_path(certificate),
        REPORT: record.path / REPORT,
    }


def before_run(record: RunRecord) -> NodeValues | None:
    """Return what attached nodes had before the run set anything.

    None of a run on nodes of its own, and where the note is gone, or is not of these nodes,
    parameters and types.
    """
    if not record.options.attached:
        return None
    try:
        noted = json.loads(read_text(record.path / LOGS / PREVIOUS_PARAMETERS))
        nodes = {record.study.nodes[key].node: values for key, values in noted.items()}
        previous = {
            node: {name: nodes[node][name] for name in values if name in nodes[node]}
            for node, values in all_values(record.study).items()
        }
        _check_like(previous, record.study)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return previous


def read_rollback(record: RunRecord) -> dict[str, dict[str, object]]:
    """Read the values to which to roll back."""
    path = record.path / DEPLOY / ROLLBACK
    try:
        first, _, text = read_text(path).partition("\n")
        if first != _DIGEST + hashlib.sha256(text.encode()).hexdigest():
            raise ValueError("does not match the digest in its first line: it was changed")
        # A study may have values in steps and starts of nodes alone.
        values = from_yaml(text) if record.study.parameters_of_nodes else {}
        _check_like(values, record.study)
    except OSError as error:
        raise RunRecordError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RunRecordError(f"{path}: {error}") from error
    return values


def _sealed(values: NodeValues) -> str:
    """Return the text of a rollback file, its digest first."""
    text = to_yaml(values)
    return f"{_DIGEST}{hashlib.sha256(text.encode()).hexdigest()}\n{text}"


def _check_restorable(values: NodeValues, study: Study) -> None:
    """Refuse values that could not be restored, such as NaN, which a parameter file cannot hold."""
    try:
        _check_like(from_yaml(to_yaml(values)), study)
    except ValueError as error:
        raise OutputError(f"{ROLLBACK}: cannot hold the nodes' values: {error}") from error


def _check_like(values: NodeValues, study: Study) -> None:
    """Check that values are of the nodes, parameters and types of a study.

    Those of a parameter with a condition may be missing.
    """
    expected = all_values(study)
    conditional = {
        (study.nodes[item.node].node, item.array or item.parameter)
        for item in study.parameters_of_nodes
        if item.when
    }
    for node, names in expected.items():
        if values.keys() != expected.keys() or not (
            {name for name in names if (node, name) not in conditional}
            <= values[node].keys()
            <= names.keys()
        ):
            raise ValueError(f"expected values of {', '.join(names)} of {node}, and no others")
        for name, value in values[node].items():
            like = names[name]
            if not _same_type(value, like):
                raise ValueError(
                    f"{node}: {name}: expected a value of the type of {like}, found "
                    f"{checks.show(values[node][name])}"
                )


def _same_type(value: object, like: object) -> bool:
    if isinstance(value, list) and isinstance(like, list):
        # Of an empty list the type is unknown.
        return not value or not like or {*map(type, value)} == {*map(type, like)}
    return type(value) is type(like)


def _provenance(record: RunRecord, trial: Trial, files: Mapping[str, bytes]) -> str:
    content = {
        "study": record.study.name,
        "run": record.path.resolve().name,
        "trial": trial.number,
        "verdict": as_mapping(run_verdict(record)),
        "parameters": dict(trial.parameters),
        "provenance": dict(record.provenance),
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(files.items())},
    }
    return json.dumps(content, indent=2) + "\n"


def _table(rows: list[Difference]) -> str:
    header = ("node", "parameter", "unit", "default", "tuned", "changed")
    cells = [
        (row.node, row.parameter, row.unit, row.now, row.new, "" if row.equal else "yes")
        for row in rows
    ]
    return csv_text([header, *cells])
