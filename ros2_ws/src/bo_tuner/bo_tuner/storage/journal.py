"""The durable record of a run: one SQLite file, to which a session only ever adds rows.

There is a committed row for each evaluation, each trial, and each event from outside.
`bo_tuner.storage.journal_reader` reads it. Each row carries a checksum of its values, since SQLite
itself notices damage to its structure, but not to what is stored.
"""

import contextlib
import json
import os
import sqlite3
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from bo_tuner.codec import checks
from bo_tuner.codec.writing import to_json
from bo_tuner.errors import JournalError
from bo_tuner.plans import Event
from bo_tuner.storage.atomic import synchronize, temporary_path
from bo_tuner.storage.rows import notes_text
from bo_tuner.storage.run_files import is_same_file
from bo_tuner.trials import Evaluation, Trial

SCHEMA_VERSION = 9
"""Of the tables and of a session's provenance; a journal of another version is refused."""

COLUMNS = {
    "session": ("provenance",),
    "trial": (
        "number", "parameters", "origin", "state", "reason", "worst_cases", "warnings",
        "hyperparameters", "evaluations", "seconds",
    ),
    "evaluation": (
        "trial", "position", "stage", "parameters", "context", "seed", "state", "reason",
        "metrics", "details", "load", "notes", "seconds",
    ),
    "event": ("phase", "tasks", "kind", "detail"),
}  # fmt: skip

SCHEMA = """
CREATE TABLE session (provenance TEXT NOT NULL, checksum INTEGER NOT NULL);
CREATE TABLE trial (
    number INTEGER NOT NULL UNIQUE, parameters TEXT NOT NULL, origin TEXT NOT NULL,
    state TEXT NOT NULL, reason TEXT NOT NULL, worst_cases TEXT NOT NULL, warnings TEXT NOT NULL,
    hyperparameters TEXT NOT NULL, evaluations INTEGER NOT NULL, seconds REAL NOT NULL,
    checksum INTEGER NOT NULL
);
CREATE TABLE evaluation (
    trial INTEGER NOT NULL, position INTEGER NOT NULL, stage TEXT NOT NULL,
    parameters TEXT NOT NULL, context TEXT NOT NULL, seed INTEGER NOT NULL, state TEXT NOT NULL,
    reason TEXT NOT NULL, metrics TEXT NOT NULL, details TEXT NOT NULL, load TEXT NOT NULL,
    notes TEXT NOT NULL, seconds REAL NOT NULL,
    checksum INTEGER NOT NULL
);
CREATE TABLE event (
    phase TEXT NOT NULL, tasks INTEGER NOT NULL, kind TEXT NOT NULL, detail TEXT NOT NULL,
    checksum INTEGER NOT NULL
);
"""


_OBJECTS = "SELECT type, name, tbl_name, sql FROM sqlite_master"

_SUPER = bytes.fromhex("d9d505f920a163d7")
"""Ends a rollback journal that names a super-journal."""

LONGEST_VALUE = 10_000_000
"""Size [byte] of a value that is neither read nor written any more."""


class Journal:
    """Append-only record of evaluations, trials and events.

    Each call that records something returns only once it is on disk.
    """

    def __init__(
        self, path: Path, provenance: Mapping[str, str], trials: Sequence[Trial] = ()
    ) -> None:
        self._path = path
        check_rollback(path)
        new = not path.exists()
        if new:
            evaluations = [evaluation for trial in trials for evaluation in trial.evaluations]
            create_journal(path, [provenance], evaluations, trials)
        try:
            # Results may be told by another thread than the one that began the run.
            self._db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        except sqlite3.Error as error:
            raise JournalError(f"{path}: {error}") from error
        try:
            harden(self._db)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            (version,) = self._db.execute("PRAGMA user_version").fetchone()
            check_version(path, version)
            check_schema(path, self._db)
            if not new:
                _insert(self._db, "session", (json.dumps(dict(provenance)),))
            self._identity = path.stat()
        except (sqlite3.Error, FileNotFoundError) as error:
            self.close()
            raise JournalError(f"{path}: {error}") from error
        except JournalError:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Use the journal in a ``with`` block, which closes it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the journal."""
        self.close()

    def record_evaluation(self, evaluation: Evaluation) -> None:
        """Append an evaluation."""
        self._record("evaluation", evaluation_row(evaluation))

    def record_trial(self, trial: Trial) -> None:
        """Append a trial whose evaluations were recorded before."""
        self._record("trial", _trial_row(trial))

    def record_event(self, event: Event) -> None:
        """Append something that came from outside."""
        self._record("event", _event_row(event))

    def count_evaluations(self) -> int:
        """Return the number of evaluations on record, those of earlier sessions included."""
        (count,) = self._db.execute("SELECT count(*) FROM evaluation").fetchone()
        return int(count)

    def close(self) -> None:
        """Close the file; unless somebody reads it just now, the log beside it is removed."""
        with contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()

    def _record(self, table: str, row: tuple[object, ...]) -> None:
        # To a file that was deleted or replaced SQLite would go on writing.
        if not is_same_file(self._path, self._identity):
            raise JournalError(f"{self._path}: was deleted, moved or replaced during the run")
        try:
            _insert(self._db, table, row)
        except sqlite3.Error as error:
            raise JournalError(f"{self._path}: {error}") from error


def create_journal(
    path: Path,
    sessions: Sequence[Mapping[str, str]],
    evaluations: Sequence[Evaluation],
    trials: Sequence[Trial],
    events: Sequence[Event] = (),
) -> None:
    """Write a journal in one step: a kill leaves the whole of it or nothing."""
    beside = temporary_path(path)
    try:
        beside.unlink(missing_ok=True)
        with contextlib.closing(sqlite3.connect(beside, isolation_level=None)) as db:
            # A file that is not finished is thrown away, so nothing will be rolled back.
            db.execute("PRAGMA journal_mode = MEMORY")
            db.execute("PRAGMA synchronous = FULL")
            db.executescript(f"BEGIN; PRAGMA user_version = {SCHEMA_VERSION}; {SCHEMA}")
            for provenance in sessions:
                _insert(db, "session", (json.dumps(dict(provenance)),))
            for evaluation in evaluations:
                _insert(db, "evaluation", evaluation_row(evaluation))
            for trial in trials:
                _insert(db, "trial", _trial_row(trial))
            for event in events:
                _insert(db, "event", _event_row(event))
            db.execute("COMMIT")
        beside.replace(path)
        synchronize(path.parent)
    except (sqlite3.Error, OSError) as error:
        raise JournalError(f"{path}: {error}") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def evaluation_row(evaluation: Evaluation) -> tuple[object, ...]:
    """Return the values of an evaluation, in the order of its `COLUMNS`."""
    outcome = evaluation.outcome
    return (
        evaluation.trial,
        evaluation.index,
        str(evaluation.stage),
        json.dumps(dict(evaluation.parameters)),
        json.dumps(dict(evaluation.context)),
        evaluation.seed,
        str(outcome.state),
        _storable(outcome.reason),
        json.dumps(dict(outcome.metrics)),
        json.dumps(dict(outcome.details)),
        json.dumps(to_json(outcome.load)),
        notes_text(outcome.notes),
        float(evaluation.seconds),
    )


def _trial_row(trial: Trial) -> tuple[object, ...]:
    return (
        trial.number,
        json.dumps(dict(trial.parameters)),
        _storable(trial.origin),
        str(trial.state),
        _storable(trial.reason),
        json.dumps(to_json(trial.worst_cases)),
        json.dumps(trial.warnings),
        json.dumps(dict(trial.hyperparameters)),
        len(trial.evaluations),
        float(trial.seconds),
    )


def _event_row(event: Event) -> tuple[object, ...]:
    return str(event.phase), event.tasks, str(event.kind), _storable(event.detail)


def _insert(db: sqlite3.Connection, table: str, row: tuple[object, ...]) -> None:
    marks = ", ".join("?" * (len(row) + 1))
    columns = ", ".join((*COLUMNS[table], "checksum"))
    db.execute(f"INSERT INTO {table} ({columns}) VALUES ({marks})", (*row, checksum(row)))


def checksum(row: Sequence[object]) -> int:
    """CRC-32 of the values of a row."""
    return zlib.crc32(repr(tuple(row)).encode())


def harden(db: sqlite3.Connection) -> None:
    """Let a database from an unknown source do nothing but hold rows.

    These are the settings of https://www.sqlite.org/security.html.
    """
    db.execute("PRAGMA trusted_schema = OFF")
    db.execute("PRAGMA cell_size_check = ON")
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_VALUE)
    # From Python 3.12 on.
    if hasattr(db, "setconfig"):
        for name, value in (("DEFENSIVE", True), ("TRUSTED_SCHEMA", False)):
            db.setconfig(getattr(sqlite3, f"SQLITE_DBCONFIG_{name}"), value)


def check_rollback(path: Path) -> None:
    """Refuse a rollback journal that leads to other files: SQLite would delete what it names."""
    rollback = path.with_name(f"{path.name}-journal")
    try:
        with rollback.open("rb") as file:
            file.seek(-min(len(_SUPER), rollback.stat().st_size), os.SEEK_END)
            end = file.read()
    except FileNotFoundError:
        return
    except OSError as error:
        raise JournalError(f"{rollback}: cannot be read: {error.strerror}") from error
    if end == _SUPER:
        raise JournalError(f"{rollback}: is not of a run: names another file")


def check_schema(path: Path, db: sqlite3.Connection) -> None:
    """Refuse a journal with other tables, or with views, triggers or indices."""
    with contextlib.closing(sqlite3.connect(":memory:")) as own:
        own.executescript(SCHEMA)
        expected = set(own.execute(_OBJECTS))
    actual = set(db.execute(_OBJECTS))
    if actual != expected:
        kind, name, *_ = sorted(actual ^ expected, key=repr)[0]
        raise JournalError(f"{path}: {kind} {checks.quoted(str(name))} is not as in a journal")


def check_version(path: Path, version: int) -> None:
    """Refuse a journal of another version."""
    if version != SCHEMA_VERSION:
        raise JournalError(
            f"{path}: journal version {version}, but this version of bo_tuner reads version "
            f"{SCHEMA_VERSION} only; use the version that made the run, or start a new run"
        )


def _storable(text: str) -> str:
    """Replace what UTF-8 cannot hold, such as half a character in a message of a node."""
    return text.encode("utf-8", "replace").decode("utf-8")
