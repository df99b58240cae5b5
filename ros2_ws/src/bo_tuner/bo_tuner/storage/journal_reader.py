"""Reading a journal: all that is whole, and what is not, in a line.

What was damaged, by a disk or a hand, ends the reading: everything before it is used. A run goes on
from there, see `salvage`.
"""

import csv
import io
import json
import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import JournalError
from bo_tuner.storage import rows
from bo_tuner.storage.atomic import synchronize, write_atomically
from bo_tuner.storage.journal import (
    COLUMNS,
    check_rollback,
    check_schema,
    check_version,
    checksum,
    create_journal,
    harden,
)
from bo_tuner.study import maxima
from bo_tuner.text import csv_cell, one_line
from bo_tuner.trials import TUNING, VALIDATED, Evaluation, Stage, Trial

OBJECTS = ("parameters", "worst_cases", "context", "metrics", "details")
"""Columns that hold JSON objects."""

NOT_EXPORTED = ("seconds", "hyperparameters")
"""Columns of no use in a table, or that differ between runs which are the same."""

# Page size and number of pages, see https://www.sqlite.org/fileformat.html.
_SQLITE = b"SQLite format 3\0"
_HEADER = struct.Struct(">16xH10xI")
_WAL_HEADER = struct.Struct(">IIIIIIII")
_FRAME_HEADER = struct.Struct(">IIIIII")


@dataclass(frozen=True)
class JournalContent:
    """What a journal holds.

    Attributes
    ----------
    sessions
        Provenance of each process that worked on the run, the first first.
    trials
        Trials with their evaluations, numbered from 0 without a gap. Checks of a trial are not
        among its evaluations.
    evaluations
        All evaluations, in the order in which they were recorded.
    damage
        What could not be read; empty if nothing is amiss.
    """

    sessions: tuple[Mapping[str, str], ...]
    trials: tuple[Trial, ...]
    evaluations: tuple[Evaluation, ...]
    damage: str


def read_journal(path: Path) -> JournalContent:
    """Read a journal, which another process may be writing.

    Raises
    ------
    JournalError
        If the file cannot be read, is no journal, or is of another version.
    """
    if not path.is_file():
        raise JournalError(f"{path}: no journal there")
    if path.stat().st_size > maxima.JOURNAL_BYTES:
        raise JournalError(f"{path}: larger than {maxima.JOURNAL_BYTES / 1e9:g} GB")
    try:
        with closing(_connect(path)) as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            check_version(path, version)
            check_schema(path, db)
            sessions, damaged_sessions = _rows(db, "session")
            evaluation_rows, damaged_evaluations = _rows(db, "evaluation")
            trial_rows, damaged_trials = _rows(db, "trial")
    except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
        if isinstance(error, JournalError):
            raise
        raise JournalError(f"{path}: {one_line(str(error))}") from error
    try:
        evaluations = tuple(rows.evaluation_of(row) for row in evaluation_rows)
        trials = tuple(_trials(trial_rows, evaluations))
        provenances = tuple(rows.provenance_of(row) for row in sessions)
    except ValueError as error:
        # The checksums hold, so it was no disk: somebody else wrote this.
        raise JournalError(
            f"{path}: rows that this program does not write: {one_line(str(error))[:200]}"
        ) from error
    missing = "" if len(trials) == len(trial_rows) else "a trial lacks some of its evaluations"
    damage = damaged_evaluations or damaged_trials or damaged_sessions or missing
    return JournalContent(
        sessions=provenances,
        trials=trials,
        evaluations=evaluations,
        damage=f"{path.name}: {damage}" if damage else "",
    )


def salvage(path: Path) -> tuple[JournalContent, str]:
    """Read a journal that no process is writing, and make a damaged one whole.

    The damaged files stay beside the new ones, under another name.

    Returns
    -------
    content
        What could be read.
    text
        What was done, in a line; empty if nothing was amiss.

    Raises
    ------
    JournalError
        As in `read_journal`, or if the new journal cannot be written.
    """
    _finish_replacement(path)
    content = read_journal(path)
    used = (
        f"everything before it is used ({len(content.trials)} trials, "
        f"{len(content.evaluations)} evaluations)"
    )
    if not content.damage:
        lost = _lost_commits(path)
        return content, f"{lost}; {used}" if lost else ""
    kept = _keep_damaged(path)
    sessions = content.sessions or ({},)
    session = dict(sessions[-1]) | {"salvaged_from": kept.name}
    create_journal(_whole(path), (*sessions, session), content.evaluations, content.trials)
    _finish_replacement(path)
    return content, f"{content.damage}; {used}, the damaged file is kept as {kept.name}"


def export_csv(path: Path, directory: Path) -> None:
    """Write ``trials.csv`` and ``evaluations.csv`` from the journal at `path`.

    Each parameter, context variable and metric has a column of its own, such as
    ``metrics.overshoot``. A trial has the mean of each metric over its draws, or over its nominal
    evaluations. Evaluations of the validation have ``default`` or ``tuned`` in place of a trial.

    Raises
    ------
    JournalError
        If the journal cannot be read.
    OutputError
        If a file cannot be written.
    """
    sides = {str(number): name for number, name in enumerate(VALIDATED)}
    means = {str(trial.number): _means(trial) for trial in read_journal(path).trials}
    for table in ("trial", "evaluation"):
        try:
            with closing(_connect(path)) as db:
                found, _ = _rows(db, table)
        except sqlite3.Error as error:
            raise JournalError(f"{path}: {one_line(str(error))}") from error
        try:
            flat = [_flat(row) for row in found]
            for row in flat:
                if table == "trial":
                    row |= means.get(str(row["number"]), {})
                elif row["stage"] == Stage.VALIDATION:
                    row["trial"] = sides.get(str(row["trial"]), row["trial"])
        except (ValueError, AttributeError, RecursionError) as error:
            raise JournalError(f"{path}: {table}: {one_line(str(error))}") from error
        names = [name for name in COLUMNS[table] if name not in NOT_EXPORTED]
        header = list(dict.fromkeys(key for row in flat for key in row)) or names
        text = io.StringIO()
        writer = csv.DictWriter(text, header)
        writer.writeheader()
        writer.writerows(flat)
        write_atomically(directory / f"{table}s.csv", text.getvalue())


def _connect(path: Path) -> sqlite3.Connection:
    """Open a journal to be read; one that was cut off is made readable in memory."""
    check_rollback(path)
    db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
    try:
        try:
            db.execute("SELECT 1 FROM sqlite_master").fetchone()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            # A kill has left a change half made, which only a writer may take back.
            with closing(sqlite3.connect(path)) as writer:
                writer.execute("SELECT 1 FROM sqlite_master").fetchone()
            db.execute("SELECT 1 FROM sqlite_master").fetchone()
    except (sqlite3.DatabaseError, UnicodeDecodeError):
        db.close()
        data = bytearray(path.read_bytes())
        if len(data) < _HEADER.size or not data.startswith(_SQLITE):
            raise
        page, pages = _HEADER.unpack_from(data)
        size = (65536 if page == 1 else page) * pages
        if not len(data) < size <= maxima.JOURNAL_BYTES:
            raise
        # What is missing reads as empty pages; without a log there is no write-ahead mode.
        data[18:20] = b"\1\1"
        db = sqlite3.connect(":memory:")
        db.deserialize(bytes(data.ljust(size, b"\0")))
    harden(db)
    db.execute("PRAGMA query_only = ON")
    return db


def _rows(db: sqlite3.Connection, table: str) -> tuple[list[dict[str, object]], str]:
    """Read a table as far as it is whole; returns the rows and what ended the reading."""
    columns = COLUMNS[table]
    query = f"SELECT {', '.join(columns)}, checksum FROM {table} ORDER BY rowid"
    found: list[dict[str, object]] = []
    try:
        for *values, expected in db.execute(query):
            if checksum(values) != expected:
                return found, f"{table} {len(found) + 1} is damaged"
            found.append(dict(zip(columns, values, strict=True)))
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        return found, f"damaged after {table} {len(found)} ({error})"
    return found, ""


def _trials(found: list[dict[str, object]], evaluations: tuple[Evaluation, ...]) -> Iterator[Trial]:
    """Put trials together, from 0 on, until one is missing or lacks an evaluation."""
    by_trial: dict[int, dict[int, Evaluation]] = {}
    for evaluation in evaluations:
        if evaluation.stage in TUNING:
            # A later one of the same place takes the place of one that a kill left behind.
            by_trial.setdefault(evaluation.trial, {})[evaluation.index] = evaluation
    for number, row in enumerate(sorted(found, key=rows.number_of)):
        of_trial = by_trial.get(number, {})
        count = rows.evaluations_of(row)
        # Not more than there are, whatever the row says.
        if rows.number_of(row) != number or count > len(of_trial):
            return
        if any(index not in of_trial for index in range(count)):
            return
        yield rows.trial_of(row, tuple(of_trial[index] for index in range(count)))


def _lost_commits(path: Path) -> str:
    """Tell whether the write-ahead log holds commits that SQLite passes over as damaged.

    See https://www.sqlite.org/walformat.html. What a kill leaves of a commit is no damage.
    """
    log = path.with_name(f"{path.name}-wal")
    try:
        data = log.read_bytes() if log.exists() else b""
        if len(data) < _WAL_HEADER.size:
            return ""
        _, _, page, _, salt, pepper, _, _ = _WAL_HEADER.unpack_from(data)
        with closing(sqlite3.connect(path)) as db:
            _, valid, _ = db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    except (OSError, sqlite3.Error) as error:
        return f"{log.name}: {error}"
    size = _FRAME_HEADER.size + page
    for start in range(_WAL_HEADER.size + valid * size, len(data) - size + 1, size):
        _, is_commit, *salts, _, _ = _FRAME_HEADER.unpack_from(data, start)
        # What a log held before it was begun anew has other salts.
        if salts != [salt, pepper]:
            break
        if is_commit:
            return f"{log.name}: damaged after page {valid}"
    return ""


def _whole(path: Path) -> Path:
    """Return where the journal stands that is about to take the place of a damaged one."""
    return path.with_name(f"{path.stem}.whole{path.suffix}")


def _keep_damaged(path: Path) -> Path:
    """Copy a journal and its log, and return the copy's path."""
    number = 1
    while (kept := path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")).exists():
        number += 1
    try:
        # The journal last: a copy that a kill has cut short is made again.
        for suffix in ("-wal", ""):
            file = path.with_name(path.name + suffix)
            if file.exists():
                write_atomically(kept.with_name(kept.name + suffix), file.read_bytes())
    except OSError as error:
        raise JournalError(f"{path}: cannot be copied: {error.strerror or error}") from error
    return kept


def _finish_replacement(path: Path) -> None:
    """Put a journal that was made whole into its place; also one that a kill has left beside.

    The log goes first: SQLite would add the commits of the damaged journal to the new one.
    """
    whole = _whole(path)
    if not whole.exists():
        return
    try:
        for suffix in ("-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        synchronize(path.parent)
        whole.replace(path)
        synchronize(path.parent)
    except OSError as error:
        raise JournalError(f"{path}: cannot be replaced: {error.strerror}") from error


def _means(trial: Trial) -> dict[str, object]:
    """Return the means of a trial's metrics, as columns."""
    metrics = {name: None for e in trial.evaluations for name in e.outcome.metrics}
    return {f"mean.{name}": csv_cell(trial.mean(name)) for name in metrics}


def _flat(row: Mapping[str, object]) -> dict[str, object]:
    """Spread the JSON objects of a row over columns of their own."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if key in NOT_EXPORTED:
            continue
        if key in OBJECTS and value is not None:
            # With the section in front: names are unique within one only.
            for name, item in json.loads(str(value)).items():
                inner = item if isinstance(item, dict) else {}
                flat |= {f"{key}.{name}.{part}": csv_cell(v) for part, v in inner.items()}
                if not inner:
                    flat[f"{key}.{name}"] = csv_cell(item)
        else:
            flat[key] = csv_cell(value)
    return flat
