"""The certificates of a run, ``RUN/certificates/``: none is ever overwritten.

Each is a pair of files, ``0001.json`` and ``0001_evaluations.csv``; the first has the digest of the
second. The number tells the order.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.judgement import most_draws_needed
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.provenance import changed_sources, sources, study_sha256
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import read_text
from bo_tuner.study import checks
from bo_tuner.study.measured import SeenRange
from bo_tuner.study.study import Study
from bo_tuner.text import one_line
from bo_tuner.trials import Trial, Value

CERTIFICATES = "certificates"
FORMAT = 5
"""Version of the files' format."""

TEXTS = frozenset(
    {"constraint", "direction", "first_failure", "kind", "metric", "name", "reason"}
    | {"side", "statistic", "study", "told", "unit"}
)
"""Keys of a certificate whose values are text, wherever they occur."""

BY_NAME = frozenset(
    {"changed", "context", "contexts", "held", "parameters", "provenance"}
    | {"seen", "worst_context"}
)
"""Keys of values by names of the study, which may be those of `TEXTS`."""

_NAME = re.compile(r"\d{4,9}\.json", re.ASCII)


def certificate_paths(folder: Path) -> list[Path]:
    """Return the certificates in a run folder, the latest first."""
    directory = folder / CERTIFICATES
    if not directory.is_dir():
        return []
    found = [path for path in directory.iterdir() if _NAME.fullmatch(path.name)]
    return sorted(found, key=_number, reverse=True)


def evaluations_path(certificate: Path) -> Path:
    """Return the path of the evaluations of a certificate."""
    return certificate.with_name(f"{certificate.stem}_evaluations.csv")


def next_path(folder: Path, attempt: int = 1) -> Path:
    """Return the path for a new certificate, with the number of its attempt, and make its folder.

    An attempt that was given up has a number, and no certificate.

    Raises
    ------
    OutputError
        If the folder cannot be made.
    """
    directory = folder / CERTIFICATES
    with writing(directory):
        directory.mkdir(exist_ok=True)
    return directory / f"{max(attempt, next_attempt(folder)):04d}.json"


def next_attempt(folder: Path) -> int:
    """Return the number after that of the latest certificate, from 1.

    Evaluations alone, which a crash has left, are no attempt: it goes on with the same draws.
    """
    return 1 + max(map(_number, certificate_paths(folder)), default=0)


def read_certificate(path: Path) -> Mapping[str, Any]:
    """Read a certificate.

    Raises
    ------
    RunRecordError
        If it is none that `validate` has written. One line.
    """
    try:
        content = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise RunRecordError(
            f"{path}: not a readable certificate: {one_line(str(error))}; run validate"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise RunRecordError(f"{path}: not a certificate of this version of bo_tuner; run validate")
    parameters, verdict = content.get("parameters"), content.get("verdict")
    if not isinstance(parameters, dict) or content.get("parameters_sha256") != parameters_sha256(
        parameters
    ):
        raise RunRecordError(f"{path}: its parameters do not match its digest; run validate")
    if verdict not in (PASS, FAIL):
        raise RunRecordError(
            f"{path}: expected {PASS} or {FAIL}, found {checks.show(verdict)}; run validate"
        )
    if found := _no_text(content):
        raise RunRecordError(f"{path}: {found}; run validate")
    return content


def _no_text(content: object, where: str = "") -> str:
    """Return which name, unit or reason in a certificate is no text; empty if all are."""
    if isinstance(content, list):
        found = [_no_text(item, f"{where}[{index}]") for index, item in enumerate(content)]
        return next(filter(None, found), "")
    for key, value in content.items() if isinstance(content, dict) else ():
        place = f"{where}.{key}".removeprefix(".")
        if key in TEXTS and not isinstance(value, str):
            return f"{place}: expected text, found {checks.show(value)}"
        if key not in BY_NAME and (found_below := _no_text(value, place)):
            return found_below
    return ""


def seen_of(content: Mapping[str, Any]) -> dict[str, SeenRange]:
    """Return what the runs of a certificate have seen of each measured context, by its name."""
    ends = ("low", "high", "mean")
    found = content.get("seen", {}).items()
    return {name: SeenRange(*(float(seen[end]) for end in ends)) for name, seen in found}


def latest_certificate(record: RunRecord, trial: Trial) -> Path | None:
    """Return the latest certificate of a trial's parameter set; None if there is none.

    Raises
    ------
    RunRecordError
        If a later one cannot be read: it may be of the same parameter set.
    """
    for path in certificate_paths(record.path):
        if is_of(read_certificate(path), trial):
            return path
    return None


def certificate_problem(record: RunRecord, trial: Trial) -> str:
    """Return in one line why no certificate of a parameter set opens `apply`; empty if one does.

    It does if it is a PASS, on enough draws and with enough confidence for the study, of exactly
    this study, parameter set, evaluations and code, and if no later one is a FAIL.
    """
    first = ""
    for path in certificate_paths(record.path):
        try:
            content = read_certificate(path)
        except RunRecordError as error:
            # It may be a FAIL.
            return first or str(error)
        if not is_of(content, trial):
            continue
        if content["verdict"] != PASS:
            return first or f"{path}: expected {PASS}, found {FAIL}"
        problem = _mismatch(record.study, path, content)
        if not problem:
            return ""
        first = first or f"{path}: {problem}; run validate"
    where = record.path / CERTIFICATES
    return first or f"{where}: no certificate of trial {trial.number}; run validate"


def required_draws(study: Study, confidence: float) -> int:
    """Return the number of draws that a certificate of a study takes."""
    return max(study.certificate.draws, most_draws_needed(study, confidence)[0])


def shortfall(study: Study, draws: object, confidence: object) -> str:
    """Return in a few words what a certificate lacks of what the study requires; else empty."""
    required = study.certificate.confidence
    needed = required_draws(study, required)
    if type(draws) is not int or draws < needed:
        return f"made with {checks.show(draws)} draws, the study requires {needed}"
    if type(confidence) is not float or not confidence >= required:
        return f"has a confidence of {checks.show(confidence)}, the study requires {required:g}"
    return ""


def evaluations_problem(path: Path, content: Mapping[str, Any]) -> str:
    """Return why the evaluations of a certificate cannot be relied on; empty if they can."""
    try:
        evaluations = hashlib.sha256(evaluations_path(path).read_bytes()).hexdigest()
    except OSError as error:
        return f"its evaluations cannot be read: {error.strerror}"
    if content.get("evaluations_sha256") != evaluations:
        return f"{evaluations_path(path).name} does not match its digest in the certificate"
    return ""


def parameters_sha256(parameters: Mapping[str, Value]) -> str:
    """Return the digest of a parameter set's JSON with sorted keys and without spaces."""
    text = json.dumps(dict(parameters), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _mismatch(study: Study, path: Path, content: Mapping[str, Any]) -> str:
    if content.get("study_sha256") != study_sha256(study):
        return "belongs to another version of the study"
    if problem := evaluations_problem(path, content):
        return problem
    missing = shortfall(study, content.get("draws"), content.get("confidence"))
    if missing:
        return missing
    provenance = content.get("provenance")
    if not isinstance(provenance, dict):
        return "does not name the code it was made with"
    changed = changed_sources(provenance, sources(study, str(provenance.get("backend"))))
    return f"the code of {', '.join(changed)} has changed since" if changed else ""


def is_of(content: Mapping[str, Any], trial: Trial) -> bool:
    """Return whether a certificate's content is of a trial's parameter set."""
    return bool(content["parameters"] == dict(trial.parameters))


def _number(path: Path) -> int:
    return int(path.stem)
