"""The evaluations of a certificate, in the CSV file beside it."""

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.store import evaluations_path
from bo_tuner.storage.csv_tables import csv_text
from bo_tuner.trials import Context, EvaluationState, Outcome, Stage

_CONTEXT, _METRIC = "context.", "metric."


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
    context
        Value of each context variable.
    seed
        Seed of the noise.
    outcome
        Its result, without details.
    """

    parameter_set: str
    stage: Stage
    index: int
    context: Context
    seed: int
    outcome: Outcome

    @property
    def metrics(self) -> Mapping[str, float]:
        """Its metrics; empty unless it is complete."""
        return self.outcome.metrics


def evaluations_csv(
    evidence: Mapping[str, Evidence], contexts: Iterable[str], metrics: Iterable[str]
) -> str:
    """Return all evaluations as CSV, a row each."""
    contexts, metrics = list(contexts), list(metrics)
    # A context and a metric may have the same name.
    columns = [*(_CONTEXT + name for name in contexts), *(_METRIC + name for name in metrics)]
    rows: list[list[object]] = [
        ["parameter_set", "stage", "index", "seed", "state", *columns, "reason"]
    ]
    for name, side in evidence.items():
        for evaluation in side.evaluations:
            outcome = evaluation.outcome
            rows.append(
                [
                    *(name, evaluation.stage, evaluation.index, evaluation.seed, outcome.state),
                    # JSON keeps a text apart from a number.
                    *(json.dumps(evaluation.context[n]) for n in contexts),
                    *(repr(outcome.metrics[n]) if n in outcome.metrics else "" for n in metrics),
                    outcome.reason,
                ]
            )
    return csv_text(rows)


def read_evaluations(certificate: Path) -> list[Row]:
    """Read the evaluations of a certificate."""
    path = evaluations_path(certificate)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [_row(cells) for cells in csv.DictReader(file)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        shown = " ".join(str(error).split())[:200]
        raise RunRecordError(f"{path}: not readable: {shown}; run validate") from error


def _row(cells: Mapping[str, str]) -> Row:
    state = EvaluationState(cells["state"])
    complete = state is EvaluationState.COMPLETE
    return Row(
        parameter_set=cells["parameter_set"],
        stage=Stage(cells["stage"]),
        index=int(cells["index"]),
        context={
            name.removeprefix(_CONTEXT): json.loads(value)
            for name, value in cells.items()
            if name.startswith(_CONTEXT)
        },
        seed=int(cells["seed"]),
        outcome=Outcome(state, _metrics(cells) if complete else {}, cells["reason"]),
    )


def _metrics(cells: Mapping[str, str]) -> dict[str, float]:
    return {
        name.removeprefix(_METRIC): float(value)
        for name, value in cells.items()
        if name.startswith(_METRIC) and value
    }
