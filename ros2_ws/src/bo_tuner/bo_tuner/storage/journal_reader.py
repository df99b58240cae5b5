"""Reading a journal: all that is whole, and what is not, in a line.

What was damaged, by a disk or a hand, ends the reading: everything before it is used, and
`bo_tuner.storage.journal_repair` makes a whole journal of it, with which the run goes on.
"""

import sqlite3
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from bo_tuner import maxima
from bo_tuner.errors import JournalError
from bo_tuner.plans import Event, EventKind
from bo_tuner.storage import rows
from bo_tuner.storage.journal import (
    COLUMNS,
    check_rollback,
    check_schema,
    check_version,
    checksum,
    harden,
)
from bo_tuner.storage.session_options import options_of
from bo_tuner.text import one_line
from bo_tuner.trials import TUNING, Evaluation, Stage, Trial, latest_by_place, withdrawn

# The header of the file, with page size and number of pages (sqlite.org/fileformat.html).
_SQLITE = b"SQLite format 3\0"
_HEADER = struct.Struct(">16xH10xI")


@dataclass(frozen=True)
class JournalContent:
    """What a journal holds.

    Attributes
    ----------
    sessions
        Provenance of each process that worked on the run, in their order.
    trials
        Trials with their evaluations, numbered from 0 without a gap. Checks of a trial are not
        among its evaluations.
    evaluations
        All evaluations, in the order in which they were recorded; where several tasks were planned
        at once, in that of `in_order_of_plans`.
    damage
        What could not be read; empty if nothing is wrong.
    events
        What came from outside, in its order.
    """

    sessions: tuple[Mapping[str, str], ...]
    trials: tuple[Trial, ...]
    evaluations: tuple[Evaluation, ...]
    damage: str
    events: tuple[Event, ...] = ()

    @property
    def to_give_again(self) -> tuple[Evaluation, ...]:
        """Evaluations that a resumed run is given in place of running them.

        What whole trials hold is not asked for again; what was lost is run again.
        """
        return tuple(
            item
            for item in self.evaluations
            if (item.stage not in TUNING or item.trial >= len(self.trials))
            and not item.outcome.unusable
        )


def read_journal(path: Path) -> JournalContent:
    """Read a journal, which another process may be writing."""
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
            event_rows, damaged_events = _rows(db, "event")
    except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
        if isinstance(error, JournalError):
            raise
        raise JournalError(f"{path}: {one_line(str(error))}") from error
    try:
        evaluations: Sequence[Evaluation] = [rows.evaluation_of(row) for row in evaluation_rows]
        provenances = tuple(rows.provenance_of(row) for row in sessions)
        if any(options_of(provenance).window > 1 for provenance in provenances):
            evaluations = in_order_of_plans(evaluations)
        trials = tuple(_trials(trial_rows, evaluations))
        events = tuple(rows.event_of(row) for row in event_rows)
        trials, evaluations = _without_withdrawn(trials, evaluations, events)
    except ValueError as error:
        # The checksums are right, so no disk has damaged it: another program wrote this.
        raise JournalError(
            f"{path}: rows that this program does not write: {one_line(str(error))[:200]}"
        ) from error
    missing = "" if len(trials) == len(trial_rows) else "a trial lacks some of its test runs"
    damaged = damaged_evaluations or damaged_trials or damaged_events or damaged_sessions
    damage = damaged or missing
    return JournalContent(
        sessions=provenances,
        trials=trials,
        evaluations=tuple(evaluations),
        damage=f"{path.name}: {damage}" if damage else "",
        events=events,
    )


def _without_withdrawn(
    trials: tuple[Trial, ...], evaluations: Sequence[Evaluation], events: Iterable[Event]
) -> tuple[tuple[Trial, ...], Sequence[Evaluation]]:
    """Return trials and evaluations, those that somebody has withdrawn as such."""
    reasons = dict(rows.withdrawal_of(e) for e in events if e.kind is EventKind.WITHDRAW)
    if not reasons:
        return trials, evaluations
    taken_back = {n: withdrawn(trials[n], why) for n, why in reasons.items() if n < len(trials)}
    known = {(e.trial, e.index): e for trial in taken_back.values() for e in trial.evaluations}
    return (
        tuple(taken_back.get(trial.number, trial) for trial in trials),
        [known.get((e.trial, e.index), e) if e.stage in TUNING else e for e in evaluations],
    )


def in_order_of_plans(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return evaluations in an order that does not depend on which of several workers was faster.

    Those of trials come first, then those of each stage after them; in a stage, those of a trial
    in the order of its plan. Of one that was run again, the last stays the last.
    """
    stages = list(Stage)

    def place(evaluation: Evaluation) -> tuple[int, int, int]:
        stage = 0 if evaluation.stage in TUNING else 1 + stages.index(evaluation.stage)
        return stage, evaluation.trial, evaluation.index

    return sorted(evaluations, key=place)


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
            # A killed process left a change half made; only a connection that writes undoes it.
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
        # Missing pages are read as empty. These bytes end the write-ahead mode: there is no log.
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
    intact: list[dict[str, object]] = []
    try:
        for *values, expected in db.execute(query):
            if checksum(values) != expected:
                return intact, f"{table} {len(intact) + 1} is damaged"
            intact.append(dict(zip(columns, values, strict=True)))
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        return intact, f"damaged after {table} {len(intact)} ({error})"
    return intact, ""


def _trials(
    trial_rows: list[dict[str, object]], evaluations: Sequence[Evaluation]
) -> Iterator[Trial]:
    """Put trials together, from 0 on, until one is missing or lacks an evaluation."""
    by_trial = latest_by_place(evaluations, TUNING)
    for number, row in enumerate(sorted(trial_rows, key=rows.number_of)):
        of_trial = by_trial.get(number, {})
        count = rows.evaluations_of(row)
        # The row may say any number; it is not trusted beyond the evaluations that there are.
        if rows.number_of(row) != number or count > len(of_trial):
            return
        if any(index not in of_trial for index in range(count)):
            return
        yield rows.trial_of(row, tuple(of_trial[index] for index in range(count)))
