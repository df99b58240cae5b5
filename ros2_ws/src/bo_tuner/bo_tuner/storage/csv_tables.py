"""Trials and evaluations of a run as tables for spreadsheets and data frames."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from bo_tuner.codec.writing import changes, to_json
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.text import csv_cell
from bo_tuner.trials import Evaluation, Trial, Value

Active = Callable[[Mapping[str, Value]], Mapping[str, Value]]
"""Leaves out of a parameter set what is not active."""


def export_csv(path: Path, directory: Path, active: Active) -> None:
    """Write ``trials.csv`` and ``evaluations.csv`` from the journal at `path`.

    Each parameter, context variable and metric has a column of its own, such as
    ``metrics.overshoot``, blank where a row has none. A trial has the mean of each metric over its
    draws, or over its nominal evaluations. Evaluations of the validation have ``default`` or
    ``tuned`` in place of a trial. Times and hyperparameters are left out: runs that are the same
    have the same tables.
    """
    content = read_journal(path)
    trials = [trial_row(trial, active) for trial in content.trials]
    evaluations = [evaluation_row(evaluation, active) for evaluation in content.evaluations]
    _write(directory / "trials.csv", trials, "number")
    _write(directory / "evaluations.csv", evaluations, "trial")


def csv_text(rows: Iterable[Iterable[object]], end: str = "\n") -> str:
    """Return rows, the header first, as text for spreadsheets, in which no text is a formula."""
    text = io.StringIO()
    csv.writer(text, lineterminator=end).writerows(map(csv_cell, row) for row in rows)
    return text.getvalue()


def trial_row(trial: Trial, active: Active) -> dict[str, object]:
    """Return a trial as a row of its table, by the names of the columns."""
    metrics = {name: None for e in trial.evaluations for name in e.outcome.metrics}
    return {
        "number": trial.number,
        **_parameters(trial.parameters, active),
        "origin": trial.origin,
        "state": str(trial.state),
        "reason": trial.reason,
        **{
            column: cell
            for name, worst in trial.worst_cases.items()
            for column, cell in _columns(f"worst_cases.{name}", to_json(worst)).items()
        },
        "warnings": json.dumps(trial.warnings),
        "evaluations": len(trial.evaluations),
        **{f"mean.{name}": trial.mean(name) for name in metrics},
    }


def evaluation_row(evaluation: Evaluation, active: Active) -> dict[str, object]:
    """Return an evaluation as a row of its table, by the names of the columns."""
    outcome = evaluation.outcome
    return {
        "trial": evaluation.whose,
        "position": evaluation.index,
        "stage": str(evaluation.stage),
        **_parameters(evaluation.parameters, active),
        **_columns("context", evaluation.context),
        "seed": evaluation.seed,
        "state": str(outcome.state),
        "reason": outcome.reason,
        **_columns("metrics", outcome.metrics),
        **_columns("details", outcome.details),
        **_noted("notes", changes(outcome.notes)),
    }


def _parameters(parameters: Mapping[str, Value], active: Active) -> dict[str, object]:
    return _columns("parameters", {**dict.fromkeys(parameters), **active(parameters)})


def _columns(section: str, values: Mapping[str, object]) -> dict[str, object]:
    """Name each column by its section, too: names are unique within one only."""
    return {f"{section}.{name}": value for name, value in values.items()}


def _noted(section: str, content: Mapping[str, object]) -> dict[str, object]:
    """Return what was noted, each number and text under a name of its own."""
    columns: dict[str, object] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            columns |= _noted(f"{section}.{name}", value)
        else:
            columns[f"{section}.{name}"] = value
    return columns


def _write(path: Path, rows: Sequence[Mapping[str, object]], first: str) -> None:
    """Write a table; one without rows has its `first` column alone."""
    columns = list(dict.fromkeys(column for row in rows for column in row)) or [first]
    cells = [[row.get(column) for column in columns] for row in rows]
    write_atomically(path, csv_text([columns, *cells], "\r\n"))
