"""A certificate, and its files in the run folder."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from bo_tuner.evidence.certificate.context_tolerance import (
    CREDIBLE,
    ContextTolerance,
    context_tolerances,
)
from bo_tuner.evidence.certificate.findings import TAIL, Earlier, Evidence, Findings
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.parameter_sensitivity import (
    ParameterSensitivity,
    parameter_sensitivity,
)
from bo_tuner.evidence.certificate.search_width import SearchWidth, search_widths
from bo_tuner.evidence.certificate.store import (
    FORMAT,
    evaluations_path,
    next_path,
    parameters_sha256,
)
from bo_tuner.evidence.certificate.winners_curse import Gap, training_gaps
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.csv_tables import csv_text
from bo_tuner.storage.json_numbers import without_nan
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.checks import same_value
from bo_tuner.study.measured import SeenRange, seen_in
from bo_tuner.study.parts import ROS
from bo_tuner.study.study import Study
from bo_tuner.trials import DEFAULT, HOLDS, TUNED, Stage, Trial, evaluations_of


@dataclass(frozen=True)
class Certificate:
    """The findings about a parameter set, with their provenance.

    Attributes
    ----------
    study
        The study.
    trial
        Number of the trial with this parameter set.
    best_sha256
        Digest of the ``best.yaml`` that holds it; None if that holds another trial's.
    draws, confidence
        Largest number of draws, and the confidence over all attempts, as requested.
    drawn
        Number of draws that were made.
    attempt
        Number of the attempt to certify a parameter set of the run, from 1.
    tuned, default
        Findings for the parameter set, and for the hand-tuned one if it was evaluated as well.
    held
        By the name of a parameter the value that a device has in place of one with more digits.
    seen
        By the name of a measured context what the evaluations of the parameter set have seen of it.
    earlier
        What was known of the parameter set before.
    widths
        Which widths of a violation its search would have found; empty without a search.
    gaps
        Training compared with validation.
    tolerances
        Robustness against the context, for each worst-case constraint of which it is known.
    sensitivity
        Robustness to steps in the parameters; None if not known.
    provenance
        Versions, sources, machine, backend and seed.
    """

    study: Study
    trial: int
    best_sha256: str | None
    draws: int
    confidence: float
    drawn: int
    attempt: int
    tuned: Findings
    default: Findings | None
    held: Mapping[str, float]
    seen: Mapping[str, SeenRange]
    earlier: Earlier
    widths: Sequence[SearchWidth]
    gaps: Sequence[Gap]
    tolerances: Sequence[ContextTolerance]
    sensitivity: ParameterSensitivity | None
    provenance: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether the tuned parameter set passes; the default is there for comparison."""
        return self.tuned.passed

    @property
    def bound_confidence(self) -> float:
        """Confidence of each bound: the share of this attempt and of one of its parameter sets."""
        return spent(self.confidence, self.attempt, 1 if self.default is None else 2)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that do not affect the verdict."""
        narrow = self.sensitivity.warning if self.sensitivity is not None else ""
        return (*((narrow,) if narrow else ()), *self._busy, *self._rounded)

    @property
    def _busy(self) -> Iterator[str]:
        """What to know of a limit on a measured time that was not shown."""
        for constraint in self.tuned.constraints:
            measured = self.study.metrics[constraint.metric].measures_time
            if measured and not constraint.passed and self.provenance["backend"] == ROS:
                yield (
                    f"{constraint.name}: {constraint.metric} depends on the load of the machine, "
                    f"which was {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; measure it "
                    "with nothing else running, on the computer that will control the machine"
                )

    @property
    def _rounded(self) -> Iterator[str]:
        """What a device holds in fewer digits than it was told, which is what was measured."""
        for name, held in self.held.items():
            told = self.tuned.parameters[name]
            yield f"{name}: the device holds {held}, in 32 bits, of the {told} that it is told"

    def to_mapping(self, evaluations_sha256: str) -> dict[str, object]:
        """Return the content of the certificate's file.

        Parameters
        ----------
        evaluations_sha256
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
            "held": dict(self.held),
            "seen": {name: asdict(found) for name, found in self.seen.items()},
            "best_yaml_sha256": self.best_sha256,
            "evaluations_sha256": evaluations_sha256,
            "draws": self.draws,
            "drawn": self.drawn,
            "confidence": self.confidence,
            "attempt": self.attempt,
            "bound_confidence": self.bound_confidence,
            "tail_level": TAIL,
            "credible": CREDIBLE,
            "objective": {
                "metric": self.study.objective.metric,
                "unit": self.study.metrics[self.study.objective.metric].unit,
                "direction": self.study.objective.direction,
            },
            "tuned": _findings(self.tuned),
            "default": None if self.default is None else _findings(self.default),
            "earlier": {
                "refutations": [asdict(refutation) for refutation in self.earlier.refutations],
                "evaluations": len(self.earlier.evaluations),
                "unread": list(self.earlier.unread),
            },
            "search_widths": [asdict(width) for width in self.widths],
            "training_gaps": [
                asdict(gap) | {"gap": gap.value, "standard_error": gap.standard_error}
                for gap in self.gaps
            ],
            "context_tolerances": [asdict(tolerance) for tolerance in self.tolerances],
            "parameter_sensitivity": _sensitivity(self.sensitivity),
            "provenance": dict(self.provenance),
            "finished": datetime.now().astimezone().isoformat(timespec="seconds"),
        }


def make_certificate(
    record: RunRecord,
    trial: Trial,
    evidence: Mapping[str, Evidence],
    draws: int,
    confidence: float,
    attempt: int,
    backend: str,
    best_sha256: str | None,
) -> Certificate:
    """Judge the evidence, and compare it with the estimates of the run.

    Parameters
    ----------
    record
        The run.
    trial
        The trial whose parameter set is judged.
    evidence
        Evaluations of the parameter set `TUNED` and, if it was evaluated, of `DEFAULT`.
    draws
        Largest number of draws.
    confidence
        Confidence over all attempts.
    attempt
        Number of this one, from 1.
    backend
        Backend on which the evaluations were run.
    best_sha256
        As in `Certificate`.
    """
    study, ranking = record.study, record.method.ranking
    tuned = evidence[TUNED]
    level = spent(confidence, attempt, len(evidence))
    findings = judge(study, tuned, level)
    trials = record.method.checked(study, record.trials, record.evaluations)
    surrogates = ranking.models(study, trials)
    in_training = evaluations_of(record.evaluations, trial.parameters)
    # Draws come last: beyond the most that the model takes they tell the least.
    fresh = [
        evaluation for evaluation in tuned.evaluations if evaluation.stage is not Stage.VALIDATION
    ]
    return Certificate(
        study=study,
        trial=trial.number,
        best_sha256=best_sha256,
        draws=draws,
        confidence=confidence,
        drawn=len(tuned.drawn),
        attempt=attempt,
        tuned=findings,
        default=judge(study, evidence[DEFAULT], level) if DEFAULT in evidence else None,
        held=_held(study, tuned),
        seen=seen_in(study.measured, tuned.evaluations),
        earlier=tuned.earlier,
        widths=_widths(study, tuned),
        gaps=training_gaps(study, trial, ranking.ranked_by(surrogates, study, trials), findings),
        tolerances=context_tolerances(study, [*fresh, *in_training, *tuned.drawn]),
        sensitivity=parameter_sensitivity(study, trial.parameters, surrogates),
        provenance=provenance(study, backend, record.algorithm),
    )


def write_certificate(
    folder: Path, certificate: Certificate, evidence: Mapping[str, Evidence]
) -> Path:
    """Write the evaluations, then the certificate with their digest; return the latter's path.

    Earlier certificates stay. The file of the certificate comes last: without it, after a crash,
    its evaluations are no certificate.

    Parameters
    ----------
    folder
        The run folder, locked.
    certificate
        The certificate.
    evidence
        Evaluations by the name of their parameter set.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    path = next_path(folder, certificate.attempt)
    table = _table(certificate.study, evidence)
    write_atomically(evaluations_path(path), table)
    digest = hashlib.sha256(table.encode()).hexdigest()
    text = json.dumps(without_nan(certificate.to_mapping(digest)), indent=2, allow_nan=False)
    return write_atomically(path, text + "\n")


def _widths(study: Study, evidence: Evidence) -> Sequence[SearchWidth]:
    """Return which violations the search met: with its own runs, not with earlier ones."""
    if not evidence.search:
        return ()
    return search_widths(study.context_space(), [e.context for e in evidence.evaluations])


def _held(study: Study, evidence: Evidence) -> dict[str, float]:
    """Return what devices have of the parameters in place of values with more digits."""
    details: dict[str, str] = {}
    for evaluation in evidence.evaluations:
        details |= evaluation.outcome.details
    held = {}
    for name, item in study.parameters.items():
        if text := details.get(f"{HOLDS}{item.node}.{item.array or item.parameter}", ""):
            # Of an array the items stand in brackets, as in JSON.
            found = json.loads(text)
            held[name] = found[item.item] if item.array else found
    return {
        name: value
        for name, value in held.items()
        if not same_value(value, evidence.parameters[name])
    }


def _findings(findings: Findings) -> dict[str, object]:
    return asdict(findings) | {"passed": findings.passed, "reasons": list(findings.reasons)}


def _sensitivity(found: ParameterSensitivity | None) -> dict[str, object] | None:
    if found is None:
        return None
    return asdict(found) | {
        "narrow": bool(found.narrow),
        "neighbours": [asdict(n) | {"tolerable": n.tolerable} for n in found.neighbours],
    }


def _table(study: Study, evidence: Mapping[str, Evidence]) -> str:
    """Return all evaluations as CSV, a row each."""
    contexts, metrics = list(study.contexts), list(study.metrics)
    # A context and a metric may have the same name.
    columns = [*(f"context.{n}" for n in contexts), *(f"metric.{n}" for n in metrics)]
    rows: list[list[object]] = [
        ["parameter_set", "stage", "index", "seed", "state", *columns, "reason"]
    ]
    for name, found in evidence.items():
        for evaluation in found.evaluations:
            outcome = evaluation.outcome
            rows.append(
                [
                    *(name, evaluation.stage, evaluation.index, evaluation.seed, outcome.state),
                    # As JSON, a text is told from a number.
                    *(json.dumps(evaluation.context[n]) for n in contexts),
                    *(repr(outcome.metrics[n]) if n in outcome.metrics else "" for n in metrics),
                    outcome.reason,
                ]
            )
    return csv_text(rows)
