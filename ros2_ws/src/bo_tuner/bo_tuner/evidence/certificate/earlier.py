"""What was known of a parameter set before its certificate: where it failed, and all its runs.

Each certificate searches for the worst context anew, and a search within a budget can miss what the
one before has found. So the contexts in which earlier evidence refuted a limit are evaluated again
by every later certificate, and the earlier runs count against a PASS.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.decisions import is_refuted_by
from bo_tuner.evidence.certificate.evaluations_file import Row, read_evaluations
from bo_tuner.evidence.certificate.findings import (
    Earlier,
    Findings,
    Refutation,
    RefutingRuns,
)
from bo_tuner.evidence.certificate.store import (
    certificate_paths,
    evaluations_problem,
    read_certificate,
)
from bo_tuner.storage.provenance import study_sha256
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    DEFAULT,
    TUNED,
    Context,
    Evaluation,
    EvaluationState,
    Value,
    evaluations_of,
)


def earlier_evidence(record: RunRecord, parameters: Mapping[str, Value], backend: str) -> Earlier:
    """Collect the earlier evidence on a parameter set: of the tuning run, then of its certificates.

    Where a limit was refuted counts whatever made the runs. The runs themselves count if they are
    of this backend: another one measures something else.
    """
    study = record.study
    # A run that was cut short shows neither that a limit is kept nor that it is not.
    own = [
        e
        for e in evaluations_of(record.evaluations, parameters)
        if not e.outcome.unusable and not e.outcome.was_cut_short
    ]
    refutations = [*_of_run(study, own)]
    evaluations = own if record.backend == backend else []
    certified, unread = False, []
    for path in reversed(certificate_paths(record.path)):
        try:
            certificate = _of_certificate(study, path, parameters)
        except RunRecordError as error:
            unread.append(str(error))
            continue
        if certificate is None:
            continue
        certified = True
        refutations += [certificate.refutation] if certificate.refutation is not None else []
        evaluations = [*evaluations, *(certificate.runs if certificate.backend == backend else [])]
        unread += [certificate.unread] if certificate.unread else []
    return Earlier(tuple(refutations), tuple(evaluations), certified, tuple(unread))


def refuted_by(number: str, findings: Findings, evaluations: Iterable[Evaluation]) -> Refutation:
    """Return what a certificate failed on."""
    contexts: list[Context] = [e.context for e in evaluations if not e.outcome.complete]
    for constraint in findings.constraints:
        if not constraint.passed:
            contexts += [worst.context for worst in constraint.worst if not worst.shown]
    return Refutation(tuple(_each_once(contexts)), number, findings)


def _of_run(study: Study, evaluations: Sequence[Evaluation]) -> Iterator[Refutation]:
    """Yield what the tuning run itself has refuted, for each constraint."""
    contexts = _each_once(e.context for e in evaluations)
    for constraint in study.worst_case_constraints:
        refuting = [
            context
            for context in contexts
            if is_refuted_by(
                constraint,
                [e for e in evaluations if e.context == context],
                study.certificate.confidence,
            )
        ]
        if refuting:
            runs = sum(e.context in refuting for e in evaluations)
            by = RefutingRuns(constraint.name, runs, len(refuting))
            yield Refutation(tuple(refuting), runs=by)


@dataclass(frozen=True)
class _Certified:
    """What a certificate failed on, its backend and its runs, or why these are not read."""

    refutation: Refutation | None
    backend: str
    runs: list[Evaluation]
    unread: str


def _of_certificate(study: Study, path: Path, parameters: Mapping[str, Value]) -> _Certified | None:
    """Read a certificate; None if it is of another parameter set, or of another study."""
    certificate = read_certificate(path, study)
    sides = {
        name: findings
        for name, findings in certificate.sides.items()
        if dict(findings.parameters) == dict(parameters)
    }
    if not sides or certificate.study_sha256 != study_sha256(study):
        return None
    side = TUNED if TUNED in sides else DEFAULT
    runs: list[Evaluation] = []
    unread = evaluations_problem(path, certificate)
    if not unread:
        runs = [
            _evaluation(row, parameters)
            for row in read_evaluations(path)
            if row.parameter_set == side and row.outcome.state is not EvaluationState.LOST
        ]
    return _Certified(
        None if sides[side].passed else refuted_by(path.stem, sides[side], runs),
        certificate.provenance.get("backend", ""),
        runs,
        f"{path}: {unread}" if unread else "",
    )


def _evaluation(row: Row, parameters: Mapping[str, Value]) -> Evaluation:
    return Evaluation(0, row.index, row.stage, parameters, row.context, row.seed, row.outcome)


def _each_once(contexts: Iterable[Context]) -> list[Context]:
    unique: list[Context] = []
    for context in contexts:
        if context not in unique:
            unique.append(context)
    return unique
