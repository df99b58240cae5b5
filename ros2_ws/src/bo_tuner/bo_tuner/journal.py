"""The durable record of a run: one SQLite file, a committed row for each cut and each trial."""

import csv
import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from bo_tuner.errors import JournalError
from bo_tuner.trials import Cut, CutOutcome, CutState, Stage, Trial, TrialState, WorstCase

SCHEMA_VERSION = 1
"""Of the tables below; a journal of another version is refused."""

SCHEMA = """
CREATE TABLE provenance (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE trial (
    number INTEGER PRIMARY KEY, parameters TEXT NOT NULL, origin TEXT NOT NULL,
    state TEXT NOT NULL, reason TEXT NOT NULL, worst_case TEXT, warnings TEXT NOT NULL,
    hyperparameters TEXT NOT NULL
);
CREATE TABLE cut (
    trial INTEGER NOT NULL, position INTEGER NOT NULL, stage TEXT NOT NULL,
    parameters TEXT NOT NULL, context TEXT NOT NULL, seed INTEGER NOT NULL, state TEXT NOT NULL,
    reason TEXT NOT NULL, metrics TEXT NOT NULL, details TEXT NOT NULL
);
"""

OBJECTS = ("parameters", "worst_case", "context", "metrics", "details")
"""Columns that hold JSON objects."""


class Journal:
    """Append-only record of cuts and trials.

    Each call that records something returns only once it is on disk.

    Parameters
    ----------
    path
        The file; made if it does not exist.
    provenance
        What produced a new journal: versions, seed, host. Ignored for an existing one.

    Raises
    ------
    JournalError
        If the file cannot be opened, is no journal, or is of another version.
    """

    def __init__(self, path: Path, provenance: Mapping[str, str] | None = None) -> None:
        self._path = path
        new = not path.exists()
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
        except sqlite3.Error as error:
            raise JournalError(f"{path}: {error}") from error
        try:
            self._open(new, provenance or {})
        except sqlite3.Error as error:
            self.close()
            raise JournalError(f"{path}: {error}") from error
        except JournalError:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Use the journal in a ``with`` block, which closes it."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the journal."""
        self.close()

    def record_cut(self, cut: Cut, parameters: Mapping[str, int | float]) -> None:
        """Append a cut of the parametrization `parameters`."""
        outcome = cut.outcome
        row = (
            cut.trial,
            cut.index,
            cut.stage,
            json.dumps(dict(parameters)),
            json.dumps(dict(cut.context)),
            cut.seed,
            outcome.state,
            outcome.reason,
            json.dumps(dict(outcome.metrics)),
            json.dumps(dict(outcome.details)),
        )
        self._insert("cut", row)

    def record_trial(self, trial: Trial) -> None:
        """Append a trial whose cuts were recorded before."""
        row = (
            trial.number,
            json.dumps(dict(trial.parameters)),
            trial.origin,
            trial.state,
            trial.reason,
            json.dumps(asdict(trial.worst_case)) if trial.worst_case else None,
            json.dumps(trial.warnings),
            json.dumps(dict(trial.hyperparameters)),
        )
        self._insert("trial", row)

    def provenance(self) -> dict[str, str]:
        """Return what produced the journal."""
        return dict(self._db.execute("SELECT key, value FROM provenance ORDER BY rowid"))

    def trials(self) -> list[Trial]:
        """Return all recorded trials with their cuts, in order."""
        cuts: dict[int, list[Cut]] = {}
        for cut in self._cuts():
            # The cuts of a validation belong to no trial.
            if cut.stage is not Stage.VALIDATION:
                cuts.setdefault(cut.trial, []).append(cut)
        rows = self._db.execute(
            "SELECT number, parameters, origin, state, reason, worst_case, warnings, "
            "hyperparameters FROM trial ORDER BY number"
        )
        return [
            Trial(
                number=number,
                parameters=json.loads(parameters),
                origin=origin,
                state=TrialState(state),
                reason=reason,
                cuts=tuple(cuts.get(number, ())),
                worst_case=WorstCase(**json.loads(worst)) if worst else None,
                warnings=tuple(json.loads(warnings)),
                hyperparameters={k: tuple(v) for k, v in json.loads(hyperparameters).items()},
            )
            for number, parameters, origin, state, reason, worst, warnings, hyperparameters in rows
        ]

    def export_csv(self, directory: Path) -> None:
        """Write ``trials.csv`` and ``cuts.csv``.

        Each parameter, context variable and metric has a column of its own, such as
        ``metrics.overshoot``.

        Raises
        ------
        JournalError
            If a file cannot be written.
        """
        for table in ("trial", "cut"):
            cursor = self._db.execute(f"SELECT * FROM {table} ORDER BY rowid")
            names = [column[0] for column in cursor.description]
            rows = [_flat(dict(zip(names, row, strict=True))) for row in cursor]
            header = list(dict.fromkeys(key for row in rows for key in row)) or names
            path = directory / f"{table}s.csv"
            try:
                with path.open("w", newline="", encoding="utf-8") as file:
                    writer = csv.DictWriter(file, header)
                    writer.writeheader()
                    writer.writerows(rows)
            except OSError as error:
                raise JournalError(f"{path}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def _open(self, new: bool, provenance: Mapping[str, str]) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        if new:
            # One transaction: a kill in between must not leave a journal without a version.
            self._db.executescript(f"BEGIN; PRAGMA user_version = {SCHEMA_VERSION}; {SCHEMA}")
            self._db.executemany("INSERT INTO provenance VALUES (?, ?)", provenance.items())
            self._db.execute("COMMIT")
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version != SCHEMA_VERSION:
            raise JournalError(
                f"{self._path}: journal version {version}; "
                f"this program reads version {SCHEMA_VERSION}"
            )

    def _cuts(self) -> list[Cut]:
        rows = self._db.execute(
            "SELECT trial, position, stage, context, seed, state, reason, metrics, details "
            "FROM cut ORDER BY rowid"
        )
        return [
            Cut(
                trial=trial,
                index=position,
                stage=Stage(stage),
                context=json.loads(context),
                seed=seed,
                outcome=CutOutcome(
                    CutState(state), json.loads(metrics), reason, json.loads(details)
                ),
            )
            for trial, position, stage, context, seed, state, reason, metrics, details in rows
        ]

    def _insert(self, table: str, row: tuple[object, ...]) -> None:
        marks = ", ".join("?" * len(row))
        try:
            self._db.execute(f"INSERT INTO {table} VALUES ({marks})", row)
        except sqlite3.Error as error:
            raise JournalError(f"{self._path}: {error}") from error


def _flat(row: dict[str, object]) -> dict[str, object]:
    """Spread the JSON objects of a row over columns of their own."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if key in OBJECTS and value is not None:
            # With the section in front: names are unique within one only.
            flat |= {f"{key}.{name}": v for name, v in json.loads(str(value)).items()}
        else:
            flat[key] = value
    return flat
