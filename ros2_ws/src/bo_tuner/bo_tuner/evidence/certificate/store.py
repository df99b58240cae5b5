"""The certificates of a run, ``RUN/certificates/``: none is ever overwritten.

Each is a pair of files, ``0001.json`` and ``0001_evaluations.csv``; the first has the digest of the
second. The numbers are in the order of making.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.reading import JSON, read
from bo_tuner.errors import RunRecordError, StudyError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.judgement import most_draws_needed
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.numbered_files import next_number, numbered_path, numbered_paths
from bo_tuner.storage.provenance import changed_sources, sources, study_sha256
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import read_text
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.study import Study
from bo_tuner.text import counted, one_line
from bo_tuner.trials import Trial, Value

CERTIFICATES = "certificates"
FORMAT = 8
"""Version of the files' format."""

FEWEST_DRAWS = 2
RUNS_KEY = ("runs",)
"""Path of the number of test runs in an error."""


def certificate_paths(folder: Path) -> list[Path]:
    """Return the certificates in a run folder, the latest first."""
    return numbered_paths(folder / CERTIFICATES)


def evaluations_path(certificate: Path) -> Path:
    """Return the path of the evaluations of a certificate."""
    return certificate.with_name(f"{certificate.stem}_evaluations.csv")


def next_path(folder: Path, attempt: int = 1) -> Path:
    """Return the path for a new certificate, with the number of its attempt, and make its folder.

    An attempt that was given up has a number, and no certificate.
    """
    directory = folder / CERTIFICATES
    with writing(directory):
        directory.mkdir(exist_ok=True)
    return numbered_path(directory, max(attempt, next_attempt(folder)))


def next_attempt(folder: Path) -> int:
    """Return the number after that of the latest certificate, from 1.

    Evaluations alone, which a crash has left, are no attempt: it goes on with the same draws.
    """
    return next_number(folder / CERTIFICATES)


def read_certificate(path: Path, study: Study) -> Certificate:
    """Read a certificate of a study."""
    try:
        content = json.loads(read_text(path))
        known = isinstance(content, dict) and content.get("format") == FORMAT
        certificate: Certificate | None = read(Certificate, content, JSON) if known else None
        if certificate is not None:
            certificate.check_names(study)
    except (OSError, ValueError, RecursionError) as error:
        raise RunRecordError(
            f"{path}: not a readable certificate: {one_line(str(error))}; run validate"
        ) from error
    if certificate is None:
        raise RunRecordError(f"{path}: not a certificate of this version of bo_tuner; run validate")
    if certificate.parameters_sha256 != parameters_sha256(certificate.parameters):
        raise RunRecordError(f"{path}: its parameters do not match its digest; run validate")
    if content.get("verdict") != certificate.verdict:
        recorded = checks.show(content.get("verdict"))
        raise RunRecordError(
            f"{path}: verdict: expected {certificate.verdict} by its findings, found {recorded}; "
            "run validate"
        )
    return certificate


def latest_certificate(record: RunRecord, trial: Trial) -> Path | None:
    """Return the latest certificate of a trial's parameter set; None if there is none."""
    for path in certificate_paths(record.path):
        if read_certificate(path, record.study).is_of(trial):
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
            certificate = read_certificate(path, record.study)
        except RunRecordError as error:
            # It may be a FAIL.
            return first or str(error)
        if not certificate.is_of(trial):
            continue
        if not certificate.passed:
            return first or f"{path}: expected {PASS}, found {FAIL}"
        problem = _mismatch(record.study, path, certificate)
        if not problem:
            return ""
        first = first or f"{path}: {problem}; run validate"
    where = record.path / CERTIFICATES
    return first or f"{where}: no certificate of trial {trial.number}; run validate"


def required_draws(study: Study, confidence: float) -> int:
    """Return the number of draws that a certificate of a study takes."""
    return max(study.certificate.draws, most_draws_needed(study, confidence)[0])


def draws_of(
    study: Study, confidence: float, attempt: int, draws: int | None = None, *, sets: int = 1
) -> int:
    """Return the largest number of draws, which must be able to show every chance constraint."""
    needed, constraint = most_draws_needed(study, spent(confidence, attempt, sets))
    if needed > maxima.TEST_RUNS:
        raise StudyError(
            f"expected a probability that {maxima.TEST_RUNS} test runs can show, found one that "
            f"takes {needed}",
            ("constraints", constraint),
        )
    if draws is None:
        draws = max(required_draws(study, confidence), needed)
    if draws > maxima.TEST_RUNS:
        raise StudyError(f"expected at most {maxima.TEST_RUNS}, found {draws}", RUNS_KEY)
    if draws < max(needed, FEWEST_DRAWS):
        why = f" to show {constraint}, even if none violates it" if constraint else ""
        raise StudyError(
            f"expected at least {max(needed, FEWEST_DRAWS)}{why}, found {draws}", RUNS_KEY
        )
    return draws


def shortfall(study: Study, draws: int, confidence: float) -> str:
    """Return in a few words what a certificate lacks of what the study requires; else empty."""
    required = study.certificate.confidence
    needed = required_draws(study, required)
    if draws < needed:
        return f"made with {counted(draws, 'test run')}, the study requires {needed}"
    if not confidence >= required:
        return f"has a confidence of {checks.show(confidence)}, the study requires {required:g}"
    return ""


def evaluations_problem(path: Path, certificate: Certificate) -> str:
    """Return why the evaluations of a certificate cannot be relied on; empty if they can."""
    try:
        evaluations = hashlib.sha256(evaluations_path(path).read_bytes()).hexdigest()
    except OSError as error:
        return f"its test runs cannot be read: {error.strerror}"
    if certificate.evaluations_sha256 != evaluations:
        return f"{evaluations_path(path).name} does not match its digest in the certificate"
    return ""


def parameters_sha256(parameters: Mapping[str, Value]) -> str:
    """Return the digest of a parameter set's JSON with sorted keys and without spaces."""
    text = json.dumps(dict(parameters), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _mismatch(study: Study, path: Path, certificate: Certificate) -> str:
    if certificate.provenance.get("backend") == FUNCTION:
        return "was made with a Python function, which is not what apply sets values on"
    if certificate.study_sha256 != study_sha256(study):
        return "belongs to another version of the study"
    if problem := evaluations_problem(path, certificate):
        return problem
    if missing := shortfall(study, certificate.draws, certificate.confidence):
        return missing
    made_by = certificate.provenance
    changed = changed_sources(made_by, sources(study, made_by.get("backend", "")))
    return f"the code of {', '.join(changed)} has changed since" if changed else ""
