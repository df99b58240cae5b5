"""A run as it is recorded in its folder; it is only read."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.codec import checks
from bo_tuner.errors import JournalError, RunRecordError, StudyError
from bo_tuner.method_names import DEFAULT_METHOD, titles
from bo_tuner.plans import Event, finished_after
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.provenance import (
    METHOD_PACKAGE,
    SIMULATION_SHA256,
    STUDY_YAML,
    file_sha256,
    session_provenance,
)
from bo_tuner.storage.rows import check_study
from bo_tuner.storage.run_files import check_files, read_text
from bo_tuner.storage.run_folder import JOURNAL, SIMULATION, STUDY, SUMMARY
from bo_tuner.storage.session_options import SessionOptions, options_of
from bo_tuner.study import study_file
from bo_tuner.study.changes import changes, summarized
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import parse_study
from bo_tuner.trials import Evaluation, Trial


@dataclass(frozen=True)
class RunRecord:
    """A run.

    Attributes
    ----------
    path
        Its folder.
    study
        The study of the last session.
    algorithm, backend
        The method, a key of `METHODS`, and the backend, as the command line names it.
    options
        Of its last session.
    provenance
        Versions, seed and host of the process that began it.
    trials
        Whole trials so far, with their evaluations but without checks.
    evaluations
        All evaluations, checks and validation included, in the order in which they were recorded.
    summary
        The content of its file; None without a readable one. `bo_tuner.tuning.summary` checks it,
        and makes it from the journal.
    damage
        What of the record could not be read, in a line; empty if nothing is wrong.
    events
        What came from outside, in its order.
    simulation
        Trials of a simulation that are prior knowledge of the machine.
    """

    path: Path
    study: Study
    algorithm: str
    backend: str
    options: SessionOptions
    provenance: Mapping[str, str]
    trials: tuple[Trial, ...]
    evaluations: tuple[Evaluation, ...]
    summary: Mapping[str, object] | None
    damage: str
    events: tuple[Event, ...] = ()
    simulation: tuple[Trial, ...] = ()

    @property
    def finished(self) -> int | None:
        """Number of trials after which it was to finish; None if it goes on to its budget."""
        return finished_after(self.events)

    @property
    def result(self) -> Trial | None:
        """The trial that is the result, by the summary; None without one."""
        number = None if self.summary is None else self.summary.get("trial")
        return next((trial for trial in self.trials if trial.number == number), None)

    def is_result(self, trial: Trial) -> bool:
        """Whether a trial has the parameter set of the result."""
        result = self.result
        return result is not None and result.parameter_set == trial.parameter_set


def read_run(path: Path) -> RunRecord:
    """Read the run in a folder, which may be going on."""
    if not path.is_dir():
        raise RunRecordError(f"{path}: no such run folder")
    if os.path.lexists(path / STUDY):
        check_files(path)
    file = path / STUDY
    if not file.is_file():
        raise RunRecordError(f"{path}: no run folder: it has no {STUDY}")
    try:
        # First, as its error is the clearer one: of another version, the study may be unreadable.
        content = read_journal(path / JOURNAL)
        simulation = _simulation(path, content.sessions)
        # The study keeps its folder: programs and code lie beside the file that the run began with.
        in_file = parse_study(study_file.read_text(file, str(file)), str(file))
    except (StudyError, JournalError) as error:
        raise RunRecordError(str(error)) from error
    study = _study(path, in_file, content.sessions)
    try:
        check_study(study, content.evaluations, content.trials)
    except ValueError as error:
        raise RunRecordError(f"{path / JOURNAL}: not of this study: {str(error)[:200]}") from error
    provenance = dict(content.sessions[0])
    provenance.pop(STUDY_YAML, None)
    algorithm = provenance.get("algorithm", "")
    if algorithm not in titles():
        raise RunRecordError(f"{path / JOURNAL}: {_unknown(algorithm, provenance)}")
    return RunRecord(
        path=path,
        study=study,
        algorithm=algorithm,
        backend=provenance.get("backend", ""),
        options=options_of(content.sessions[-1]),
        provenance=provenance,
        trials=content.trials,
        evaluations=content.evaluations,
        summary=_summary(path / SUMMARY),
        damage=content.damage,
        events=content.events,
        simulation=simulation,
    )


def record_of_study(study: Study, path: Path, backend: str) -> RunRecord:
    """Return the record of a study of which nothing was run."""
    return RunRecord(
        path=path,
        study=study,
        algorithm=DEFAULT_METHOD,
        backend=backend,
        options=SessionOptions(),
        provenance=session_provenance(study, backend, DEFAULT_METHOD),
        trials=(),
        evaluations=(),
        summary=None,
        damage="",
    )


def _unknown(algorithm: str, provenance: Mapping[str, str]) -> str:
    """Return why the algorithm of a run is none that there is here."""
    named = checks.quoted(algorithm) if algorithm else "none"
    if package := provenance.get(METHOD_PACKAGE):
        owner = checks.quoted(package)
        return f"its algorithm {named} is of the package {owner}, which is not installed"
    return f"no known algorithm in its provenance: {named}"


def _study(path: Path, in_file: Study, sessions: Sequence[Mapping[str, str]]) -> Study:
    """Return the study of the last session after comparing its file with it."""
    if not sessions:
        raise RunRecordError(f"{path / JOURNAL}: no session can be read")
    try:
        texts = dict.fromkeys(session[STUDY_YAML] for session in sessions)
        studies = [parse_study(text, "study on record") for text in texts]
    except (KeyError, StudyError) as error:
        raise RunRecordError(f"{path / JOURNAL}: no study in its provenance: {error}") from error
    # The file may still be that of an earlier session: it is replaced once the session with more
    # trials is on record.
    if in_file not in studies:
        raise RunRecordError(
            f"{path / STUDY}: is not the study on record: "
            f"{summarized(changes(studies[-1], in_file))}; restore it, or start a new run with it"
        )
    return studies[-1]


def _simulation(path: Path, sessions: Sequence[Mapping[str, str]]) -> tuple[Trial, ...]:
    """Read the trials of a simulation that the run knows."""
    digests = {session.get(SIMULATION_SHA256) for session in sessions} - {None}
    if not digests:
        return ()
    file = path / SIMULATION
    trials = read_journal(file).trials
    if digests != {file_sha256(file)}:
        raise JournalError(f"{file}: is not the file that the run began with; restore it")
    return trials


def _summary(path: Path) -> Mapping[str, object] | None:
    """Read a summary; None if there is no readable one, since it can be made from the journal."""
    try:
        summary = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError):
        return None
    return summary if isinstance(summary, dict) else None
