"""The evaluations of a certificate that is not finished, so that `validate` can continue it.

``RUN/certificates/unfinished.jsonl`` has a line for what they belong to, then one for each, with
the columns of the journal. It goes when the certificate is written.
"""

import errno
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import StudyError
from bo_tuner.evidence.certificate.store import CERTIFICATES, next_attempt, parameters_sha256
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.journal import COLUMNS, evaluation_row
from bo_tuner.storage.provenance import sources, study_sha256
from bo_tuner.storage.rows import evaluation_of
from bo_tuner.storage.run_files import open_file
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState, Value
from bo_tuner.tuning.observer import RunObserver

UNFINISHED = "unfinished.jsonl"


def evaluations_begun(folder: Path, study: Study, trial: Trial) -> int:
    """Return how many evaluations of an unfinished certificate of a trial `validate` goes on with.

    Those of anything else, or of other code, it makes anew.
    """
    begun = _begun(folder)
    if begun is None or begun.attempt < next_attempt(folder):
        return 0
    return begun.evaluations if begun.is_of(study, trial.parameters, begun.backend) else 0


def trial_begun(folder: Path, study: Study, trials: Iterable[Trial], backend: str) -> Trial | None:
    """Return the trial whose unfinished certificate `validate` goes on with, if there is one."""
    begun = _begun(folder)
    if begun is None or begun.attempt < next_attempt(folder):
        return None
    for trial in trials:
        # One that was lost may have had the same parameters before.
        if trial.state is not TrialState.COMPLETE:
            continue
        # The head has digests of all code, which take their time.
        if parameters_sha256(trial.parameters) in begun.head:
            return trial if begun.is_of(study, trial.parameters, backend) else None
    return None


def attempt_for(folder: Path, study: Study, parameters: Mapping[str, Value], backend: str) -> int:
    """Return the number of the attempt to certify a parameter set, from 1.

    An unfinished one of the same parameter set goes on. One of another was given up, and counts if
    it has an evaluation: giving up undecided attempts and trying others would pass too often.
    """
    begun, following = _begun(folder), next_attempt(folder)
    if begun is None:
        return following
    goes_on = not begun.evaluations or begun.is_of(study, parameters, backend)
    return max(following, begun.attempt if goes_on else begun.attempt + 1)


@dataclass(frozen=True)
class _Begun:
    """The first line of the file, what it says, and how many evaluations follow."""

    head: str
    backend: str
    attempt: int
    evaluations: int

    def is_of(self, study: Study, parameters: Mapping[str, Value], backend: str) -> bool:
        try:
            return self.head == _head(study, parameters, backend, self.attempt)
        except StudyError:
            return False


def _begun(folder: Path) -> _Begun | None:
    try:
        head, *lines = (folder / CERTIFICATES / UNFINISHED).read_text("utf-8").splitlines()
        header = json.loads(head)
        return _Begun(head, str(header["backend"]), int(header["attempt"]), len(lines))
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


class Unfinished(RunObserver):
    """Keeps each evaluation; those of an interrupted certificate are there at the beginning.

    Evaluations that were lost or disturbed are left out: they end a certificate without a verdict,
    and are made anew.

    Attributes
    ----------
    evaluations
        Those on record already.
    """

    def __init__(
        self,
        folder: Path,
        study: Study,
        parameters: Mapping[str, Value],
        backend: str,
        attempt: int,
    ) -> None:
        self._path = folder / CERTIFICATES / UNFINISHED
        head = _head(study, parameters, backend, attempt)
        lines = self._read(head)
        self.evaluations = [evaluation for evaluation, _ in lines]
        with writing(self._path):
            self._path.parent.mkdir(exist_ok=True)
            # Written anew, without a line that a crash has cut off.
            known = "".join(f"{line}\n" for line in (head, *(line for _, line in lines)))
            write_atomically(self._path, known)
            descriptor = open_file(self._path, os.O_WRONLY | os.O_APPEND)
            # Without a buffer: what a full disk has refused is not written again by closing it.
            self._file = os.fdopen(descriptor, "wb", buffering=0)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Keep an evaluation."""
        if evaluation.recorded or evaluation.outcome.unusable:
            return
        row = dict(zip(COLUMNS["evaluation"], evaluation_row(evaluation), strict=True))
        with writing(self._path):
            self._write(json.dumps(row))

    def close(self) -> None:
        """Keep the file for a later session."""
        self._file.close()

    def remove(self) -> None:
        """Remove the file: the certificate is written."""
        self._file.close()
        self._path.unlink(missing_ok=True)

    def _write(self, line: str) -> None:
        content = f"{line}\n".encode()
        if self._file.write(content) != len(content):
            # A disk that is full takes the beginning.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _read(self, head: str) -> list[tuple[Evaluation, str]]:
        try:
            first, *lines = self._path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            return []
        kept: list[tuple[Evaluation, str]] = []
        if first != head:
            return kept
        for line in lines:
            try:
                kept.append((evaluation_of(json.loads(line)), line))
            except (ValueError, KeyError, TypeError, RecursionError):
                break
        return kept


def _head(study: Study, parameters: Mapping[str, Value], backend: str, attempt: int) -> str:
    """Return the first line: what the certificate is of."""
    head = {
        "study_sha256": study_sha256(study),
        "parameters_sha256": parameters_sha256(parameters),
        "backend": backend,
        "attempt": attempt,
    }
    return json.dumps(head | sources(study, backend))
