"""A certificate as a whole, and its files in the folder of the run."""

import csv
import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from bo_tuner.certificate.evidence import TAIL, Evidence, Findings
from bo_tuner.certificate.neighbourhood import Neighbourhood, look_around
from bo_tuner.certificate.robustness import CREDIBLE, ContextTolerance, context_tolerance
from bo_tuner.certificate.verdict import FAIL, PASS, judge
from bo_tuner.certificate.winners_curse import Gap, training_gaps
from bo_tuner.errors import OutputError
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.optimizers.ranking import rank
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import without_nan
from bo_tuner.study.study import Study
from bo_tuner.trials import Stage, Trial, Value

CERTIFICATE = "certificate.json"
TUNED, DEFAULT = "tuned", "default"
FORMAT = 1
"""Version of the file's layout."""


@dataclass(frozen=True)
class Certificate:
    """What was found out about a parameter set, and how.

    Attributes
    ----------
    study
        The study.
    trial
        Number of the trial whose parameter set this is of.
    best_sha256
        Digest of the ``best.yaml`` that holds it; None if it is another trial's.
    draws, confidence
        As asked for.
    tuned, default
        Findings of the parameter set and of the hand-tuned one.
    gaps
        Training against validation.
    context, neighbours
        Robustness, as far as it can be told.
    provenance
        Versions, sources, machine, backend and seed.
    """

    study: Study
    trial: int
    best_sha256: str | None
    draws: int
    confidence: float
    tuned: Findings
    default: Findings
    gaps: Sequence[Gap]
    context: ContextTolerance | None
    neighbours: Neighbourhood | None
    provenance: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether the tuned parameter set passes; the default is there for comparison."""
        return self.tuned.passed

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know of it, whether it passed or not."""
        narrow = self.neighbours.warning if self.neighbours is not None else ""
        return (narrow,) if narrow else ()

    def layout(self, evaluations_sha256: str) -> dict[str, object]:
        """Lay the certificate out for its file.

        Parameters
        ----------
        cuts_sha256
            Digest of the file with the evaluations.
        """
        return {
            "format": FORMAT,
            "verdict": PASS if self.passed else FAIL,
            "reasons": list(self.tuned.reasons),
            "warnings": list(self.warnings),
            "study": self.study.name,
            "study_sha256": self.provenance["study_sha256"],
            "trial": self.trial,
            "parameters": dict(self.tuned.parameters),
            "parameters_sha256": parameters_sha256(self.tuned.parameters),
            "best_yaml_sha256": self.best_sha256,
            "cuts_sha256": evaluations_sha256,
            "draws": self.draws,
            "confidence": self.confidence,
            "tail_level": TAIL,
            "credible": CREDIBLE,
            "objective": {
                "metric": self.study.objective.metric,
                "unit": self.study.metrics[self.study.objective.metric].unit,
                "direction": self.study.objective.direction,
            },
            "tuned": _findings(self.tuned),
            "default": _findings(self.default),
            "training_gaps": [
                asdict(gap) | {"gap": gap.value, "standard_error": gap.standard_error}
                for gap in self.gaps
            ],
            "context_tolerance": None if self.context is None else asdict(self.context),
            "neighbourhood": _neighbourhood(self.neighbours),
            "provenance": dict(self.provenance),
            "finished": datetime.now().astimezone().isoformat(timespec="seconds"),
        }


def make_certificate(
    record: RunRecord,
    trial: Trial,
    evidence: Mapping[str, Evidence],
    confidence: float,
    backend: str,
    best_sha256: str | None,
) -> Certificate:
    """Judge the evidence, and compare it with what the run believed.

    Parameters
    ----------
    record
        The run.
    trial
        Whose parameter set is judged.
    evidence
        Evaluations of the parameter sets `TUNED` and `DEFAULT`.
    confidence
        Of all bounds.
    backend
        Where the evaluations were run.
    best_sha256
        As in `Certificate`.
    """
    study, models = record.study, ALGORITHMS[record.algorithm].models
    tuned = evidence[TUNED]
    findings = judge(study, tuned, confidence)
    rng = generator(study.seed, Stream.ACQUISITION, 2**31, len(record.trials))
    surrogates = Surrogates.fit(study, record.trials, rng=rng, options=models)
    in_training = [e for e in record.evaluations if e.parameters == trial.parameters]
    # Draws come last: beyond the most that the model takes they tell the least.
    fresh = [
        evaluation for evaluation in tuned.evaluations if evaluation.stage is not Stage.VALIDATION
    ]
    return Certificate(
        study=study,
        trial=trial.number,
        best_sha256=best_sha256,
        draws=len(tuned.drawn),
        confidence=confidence,
        tuned=findings,
        default=judge(study, evidence[DEFAULT], confidence),
        gaps=training_gaps(study, trial, rank(study, record.trials, models), findings),
        context=context_tolerance(study, [*fresh, *in_training, *tuned.drawn]),
        neighbours=look_around(study, trial.parameters, surrogates),
        provenance=provenance(study, backend, record.algorithm),
    )


def write_certificate(
    folder: Path, name: str, certificate: Certificate, evidence: Mapping[str, Evidence]
) -> Path:
    """Write the evaluations, then the certificate with their digest; returns the latter's path.

    Each file appears as a whole or not at all.

    Parameters
    ----------
    folder
        Of the run.
    name
        File name of the certificate.
    certificate
        The certificate.
    evidence
        Evaluations by the name of their parameter set.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    table = _table(certificate.study, evidence)
    _write(folder / f"{Path(name).stem}_cuts.csv", table)
    digest = hashlib.sha256(table.encode()).hexdigest()
    text = json.dumps(without_nan(certificate.layout(digest)), indent=2, allow_nan=False)
    return _write(folder / name, text + "\n")


def parameters_sha256(parameters: Mapping[str, Value]) -> str:
    """Digest of a parameter set: of its JSON with sorted keys and without spaces."""
    text = json.dumps(dict(parameters), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _findings(findings: Findings) -> dict[str, object]:
    return asdict(findings) | {"passed": findings.passed, "reasons": list(findings.reasons)}


def _neighbourhood(neighbours: Neighbourhood | None) -> dict[str, object] | None:
    if neighbours is None:
        return None
    return asdict(neighbours) | {
        "narrow": bool(neighbours.narrow),
        "neighbours": [asdict(n) | {"tolerable": n.tolerable} for n in neighbours.neighbours],
    }


def _table(study: Study, evidence: Mapping[str, Evidence]) -> str:
    """Lay out all evaluations as CSV, a row each."""
    text = io.StringIO()
    contexts, metrics = list(study.contexts), list(study.metrics)
    # Names of contexts and metrics may be the same.
    columns = [*(f"context.{n}" for n in contexts), *(f"metric.{n}" for n in metrics)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["parametrization", "stage", "index", "seed", "state", *columns, "reason"])
    for name, found in evidence.items():
        for evaluation in found.evaluations:
            outcome = evaluation.outcome
            writer.writerow(
                [
                    *(name, evaluation.stage, evaluation.index, evaluation.seed, outcome.state),
                    *(repr(evaluation.context[n]) for n in contexts),
                    *(repr(outcome.metrics[n]) if n in outcome.metrics else "" for n in metrics),
                    outcome.reason,
                ]
            )
    return text.getvalue()


def _write(path: Path, text: str) -> Path:
    draft = path.with_name(f".{path.name}.new")
    try:
        with draft.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    return path
