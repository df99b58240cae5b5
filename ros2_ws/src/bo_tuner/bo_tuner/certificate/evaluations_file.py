"""Reads the evaluations of a certificate from the CSV file beside it."""

import csv
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.certificate.store import evaluations_path
from bo_tuner.errors import RunRecordError
from bo_tuner.trials import EvaluationState, Stage

_METRIC = "metric."


@dataclass(frozen=True)
class Row:
    """An evaluation of a certificate.

    Attributes
    ----------
    parameter_set
        ``default`` or ``tuned``.
    stage
        Why it was run.
    index
        Its number within the stage; of a draw the same for both parameter sets.
    metrics
        Its metrics; empty unless it is complete.
    """

    parameter_set: str
    stage: Stage
    index: int
    metrics: dict[str, float]


def read_evaluations(certificate: Path) -> list[Row]:
    """Read the evaluations of a certificate.

    Raises
    ------
    RunRecordError
        If they cannot be read. One line.
    """
    path = evaluations_path(certificate)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [
                Row(
                    parameter_set=row["parameter_set"],
                    stage=Stage(row["stage"]),
                    index=int(row["index"]),
                    metrics={
                        name.removeprefix(_METRIC): float(value)
                        for name, value in row.items()
                        if name.startswith(_METRIC) and value
                    }
                    if row["state"] == EvaluationState.COMPLETE
                    else {},
                )
                for row in csv.DictReader(file)
            ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        shown = " ".join(str(error).split())[:200]
        raise RunRecordError(f"{path}: not readable: {shown}; run validate") from error
