"""A run as it stands in its folder, for whoever wants to know of it; nothing is written."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import JournalError, RunRecordError, StudyError
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.rows import check_study
from bo_tuner.storage.run_files import check_files, read_text
from bo_tuner.storage.run_folder import JOURNAL, STUDY, SUMMARY
from bo_tuner.study import checks
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, Trial


@dataclass(frozen=True)
class RunRecord:
    """A run.

    Attributes
    ----------
    path
        Its folder.
    study
        The study as run.
    algorithm, backend
        What it is run by; keys of `ALGORITHMS` and of the command line.
    provenance
        Versions, seed and host of the process that began it.
    trials
        Whole trials so far, with their evaluations but without checks.
    evaluations
        All evaluations, checks and validation included, in the order in which they were recorded.
    summary
        The result; None while the run has not ended.
    damage
        What of the record could not be read, in a line; empty if nothing is amiss.
    """

    path: Path
    study: Study
    algorithm: str
    backend: str
    provenance: Mapping[str, str]
    trials: tuple[Trial, ...]
    evaluations: tuple[Evaluation, ...]
    summary: Mapping[str, object] | None
    damage: str


def read_run(path: Path) -> RunRecord:
    """Read the run in a folder, which may be going on.

    Raises
    ------
    RunRecordError
        If it is no run folder, holds links or pipes, or its study or journal cannot be read.
        One line.
    """
    if not path.is_dir():
        raise RunRecordError(f"{path}: no such run folder")
    if os.path.lexists(path / STUDY):
        check_files(path)
    if not (path / STUDY).is_file():
        raise RunRecordError(f"{path}: no run folder: it has no {STUDY}")
    try:
        study = load_study(path / STUDY)
        content = read_journal(path / JOURNAL)
    except (StudyError, JournalError) as error:
        raise RunRecordError(str(error)) from error
    try:
        check_study(study, content.evaluations, content.trials)
    except ValueError as error:
        raise RunRecordError(f"{path / JOURNAL}: not of this study: {str(error)[:200]}") from error
    provenance = content.sessions[0] if content.sessions else {}
    algorithm = provenance.get("algorithm", "")
    if algorithm not in ALGORITHMS:
        named = checks.quoted(algorithm) if algorithm else "none"
        raise RunRecordError(f"{path / JOURNAL}: no known algorithm in its provenance: {named}")
    return RunRecord(
        path=path,
        study=study,
        algorithm=algorithm,
        backend=provenance.get("backend", ""),
        provenance=provenance,
        trials=content.trials,
        evaluations=content.evaluations,
        summary=_summary(path / SUMMARY),
        damage=content.damage,
    )


def _summary(path: Path) -> Mapping[str, object] | None:
    try:
        summary = json.loads(read_text(path))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise RunRecordError(f"{path}: cannot be read: {error}") from error
    if not isinstance(summary, dict):
        raise RunRecordError(f"{path}: expected an object")
    trial = summary.get("trial")
    if isinstance(trial, bool) or not isinstance(trial, int):
        raise RunRecordError(f"{path}: trial: expected a number, found {checks.show(trial)}")
    return summary
