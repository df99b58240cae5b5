"""The verdict on the result of a run, by its latest certificate if there is one."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

from bo_tuner.codec.reading import JSON, read
from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.at_bounds import at_bounds
from bo_tuner.evidence.branches import branches
from bo_tuner.evidence.busy import COMPUTING, high_load, times_by
from bo_tuner.evidence.certificate.claim import claimed, failed_before, objections, seen
from bo_tuner.evidence.certificate.evaluations_file import Row, read_evaluations
from bo_tuner.evidence.certificate.findings import ConstraintVerdict, Findings, widest
from bo_tuner.evidence.certificate.store import (
    certificate_paths,
    certificate_problem,
    latest_certificate,
    read_certificate,
)
from bo_tuner.evidence.certificate.unfinished import evaluations_begun
from bo_tuner.evidence.declarations import contradicted, drifts, two_kinds, uneven
from bo_tuner.evidence.differences import Difference
from bo_tuner.evidence.estimates import Source
from bo_tuner.evidence.facts import (
    NO_CLAIM,
    ApplyRefuses,
    ApplyWaits,
    Basis,
    BetterSet,
    Biases,
    CertificateBegun,
    ComputingTimes,
    Confidence,
    Effects,
    Fact,
    MetricBias,
    PassedOver,
    Said,
    SearchStoodStill,
    TrialsEnded,
)
from bo_tuner.evidence.limit_verdict import LimitVerdict, by_certificate
from bo_tuner.evidence.observed import Observed, WorstMean
from bo_tuner.evidence.quantities import quantities
from bo_tuner.evidence.quantity import ViolationBound
from bo_tuner.evidence.validated import (
    is_default,
    open_verdict,
    validated,
)
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.plans import TIME_UP, finish_in, standstill_in
from bo_tuner.storage.record import RunRecord
from bo_tuner.study import limits
from bo_tuner.study.measured import seen_in
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    DEFAULT,
    TUNED,
    Evaluation,
    Stage,
    Trial,
    Value,
    count_trials,
    evaluations_of,
)
from bo_tuner.tuning.effects import ParameterEffects
from bo_tuner.tuning.prospects import Prospects
from bo_tuner.tuning.recorded_method import recorded_method
from bo_tuner.tuning.validation import Validation


def run_verdict(record: RunRecord) -> Verdict:
    """Return the verdict on the result of a run."""
    verdict = replace(_with_load(record, _latest(record)), plays_bags=record.study.plays_bags)
    faults = contradicted(record.study, record.evaluations)
    return _with(verdict, *faults, *_unfinished(record))


def _with(verdict: Verdict, *facts: Fact) -> Verdict:
    return replace(verdict, remarks=(*verdict.remarks, *facts))


def _unfinished(record: RunRecord) -> Iterator[Fact]:
    """Yield what of a run with a result was ended early, or has only begun."""
    trial, finish = record.result, finish_in(record.events)
    if trial is None:
        return
    if finish is not None:
        made, planned = count_trials(record.trials), record.study.budget.trials
        yield TrialsEnded(made, planned, time_up=finish == TIME_UP)
    if begun := evaluations_begun(record.path, record.study, trial):
        yield CertificateBegun(begun)


def _latest(record: RunRecord) -> Verdict:
    by_validation, trial = _by_validation(record), record.result
    standstill = standstill_in(record.events)
    if by_validation is None or trial is None:
        return open_verdict(record.study, record.trials, standstill)
    if standstill:
        stood = _with(by_validation, SearchStoodStill(len(record.trials), standstill))
        by_validation = replace(stood, standstill=True)
    try:
        path = latest_certificate(record, trial)
        return by_validation if path is None else _certified(record, trial, path, by_validation)
    except RunRecordError as error:
        return _with(by_validation, Said(f"Certificate: {error}"))


def _by_validation(record: RunRecord) -> Verdict | None:
    """Return the verdict by the validation of `tune`; None if the run has no result."""
    summary = record.summary
    trials = {trial.number: trial for trial in record.trials}
    if summary is None:
        return None
    try:
        trial = trials[summary["trial"]]  # type: ignore[index]
        default, tuned = (read(Validation, summary[key], JSON) for key in (DEFAULT, TUNED))
        feasibility = float(str(summary.get("predicted_feasibility") or 0.0))
        checked = trial.number in summary.get("checked_trials", ())  # type: ignore[operator]
        method = recorded_method(record)
        verdict = validated(
            record.study,
            trial.number,
            default,
            tuned,
            record.trials,
            record.evaluations,
            doubt="" if bool(summary["passed_check"]) else method.doubt(feasibility),
            likely=method.is_likely(feasibility, checked=checked),
            prospects=read(Prospects | None, summary.get("prospects"), JSON),
            outliers=_outliers(record, summary.get("ranked_trials")),
        )
        runs = [e for e in record.evaluations if e.stage is Stage.VALIDATION]
        ranges = seen_in(record.study.measured, evaluations_of(runs, trial.parameters))
        effects = read(tuple[ParameterEffects, ...], summary.get("effects", ()), JSON)
        alike = {side: [e for e in runs if e.whose == side] for side in (DEFAULT, TUNED)}
        # The default was not chosen by its runs: those of its trial are like those of the end.
        alike[DEFAULT] = [*_drawn(record, default.parameters), *alike[DEFAULT]]
        return _with(
            replace(verdict, effects=Effects(record.study, tuple(effects))),
            *branches(record.study, record.trials),
            *_passed_over(record.study, summary.get("passed_over", ())),  # type: ignore[arg-type]
            *_biases(record.study, summary.get("biases", ())),  # type: ignore[arg-type]
            *seen(record.study, ranges),
            *drifts(record.study, alike),
            *two_kinds(record.study, alike),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunRecordError(
            f"{record.path}: its summary is not one of tune's: {str(error)[:200]!r}"
        ) from error


def _passed_over(study: Study, found: Sequence[Mapping[str, Any]]) -> Iterator[PassedOver]:
    """Yield the better parameter sets that were passed over, from ``summary.json``, if any."""
    metric = study.metrics[study.objective.metric]
    sets = tuple(
        BetterSet(
            int(item["trial"]), float(item["objective"]), float(item["feasibility"]), item["shown"]
        )
        for item in found
    )
    if sets:
        yield PassedOver(metric.title, metric.unit, sets, compromises=len(study.objectives) > 1)


def _biases(study: Study, found: Sequence[Mapping[str, Any]]) -> Iterator[Biases]:
    """Yield how far the machine is from its simulation, from ``summary.json``, if it says so."""
    biases = tuple(
        MetricBias(
            study.metrics[str(item["metric"])].title,
            study.metrics[str(item["metric"])].unit,
            float(item["simulated"]),
            Difference(float(item["difference"]), float(item["low"]), float(item["high"]), 0),
        )
        for item in found
    )
    if biases:
        yield Biases(biases)


def _drawn(record: RunRecord, parameters: Mapping[str, Value]) -> list[Evaluation]:
    """Return the evaluations of a parameter set in the trials, in contexts that were drawn."""
    known = evaluations_of(record.evaluations, parameters)
    return [evaluation for evaluation in known if evaluation.stage is Stage.DRAWN]


def _outliers(record: RunRecord, ranked: object) -> list[int]:
    """Return the trials that broke no limit, but were not ranked as they are outliers.

    Not ranked are also those that repeat a parameter set, since its evaluations count as one trial,
    and those that failed when they were run again.
    """
    if not isinstance(ranked, list):
        return []
    key = record.study.search_space().key
    known = {key(trial.parameters) for trial in record.trials if trial.number in ranked}
    known |= {key(e.parameters) for e in record.evaluations if not e.outcome.complete}
    return [
        trial.number
        for trial in record.trials
        if key(trial.parameters) not in known and limits.keeps_limits(record.study, trial)
    ]


def certified(record: RunRecord, trial: Trial, path: Path) -> Verdict:
    """Return the verdict on a trial by a certificate of it."""
    return _with_load(record, _certified(record, trial, path, _by_validation(record)))


def _with_load(record: RunRecord, verdict: Verdict) -> Verdict:
    """Return a verdict with what the load of the computer was in the runs on record."""
    names = times_by(record.study, record.evaluations, COMPUTING)
    titles = tuple(record.study.metrics[name].title for name in names)
    high = high_load(record.study, record.evaluations)
    verdict = replace(verdict, high_load=high)
    of_times = [ComputingTimes(titles)] if titles else []
    return _with(verdict, *of_times, *uneven(record.study, record.evaluations))


def _certified(
    record: RunRecord, trial: Trial, path: Path, by_validation: Verdict | None
) -> Verdict:
    certificate = read_certificate(path, record.study)
    remarks: list[Fact] = []
    rows: Sequence[Row] = []
    try:
        rows = read_evaluations(path)
    except RunRecordError as error:
        remarks.append(Said(str(error)))
    study, same = record.study, is_default(record.study, trial.parameters)
    is_result, passed = record.is_result(trial), certificate.passed
    given = not record.trials
    # There is no run whose result could be applied.
    problem = certificate_problem(record, trial) if passed and not given else ""
    if problem:
        remarks.append(ApplyRefuses(problem))
    has_result = record.result is not None
    if passed and not has_result and not given:
        remarks.append(ApplyWaits())
    draws, confidence = certificate.drawn, certificate.bound_confidence
    overall = min(certificate.confidence, *_confidences(record))
    tuned, default = certificate.tuned, certificate.default
    reasons = objections(study, tuned)
    of_trial = _observed(tuned, rows, TUNED, draws, _on_record(record, trial))
    if default is None:
        observed, default_reasons = _beside_validation(by_validation, of_trial, is_result)
        default_limits = {} if by_validation is None else _default_limits(by_validation)
    else:
        observed = (_observed(default, rows, DEFAULT, draws, []), of_trial)
        default_reasons = objections(study, default)
        default_limits = _limits(study, default, draws)
    numbers = quantities(
        study,
        *observed,
        default_limits,
        _limits(study, tuned, draws),
        {c.name: _violation(study, c, draws, confidence) for c in tuned.constraints},
    )
    return Verdict(
        state=State.CERTIFIED if passed else State.REFUSED,
        trial=trial.number,
        basis=_basis(draws, default is not None, by_validation, is_result),
        reasons=reasons,
        default_reasons=reasons if same else default_reasons,
        quantities=numbers,
        trade_offs=by_validation.trade_offs if by_validation is not None and is_result else (),
        remarks=(
            *failed_before(study, certificate),
            Confidence(confidence, overall, str(record.path) if given else ""),
            *seen(study, certificate.seen),
            *remarks,
        ),
        observed=observed,
        default_certified=default is not None,
        apply_refuses=bool(problem),
        is_default=same,
        is_result=is_result,
        has_result=has_result,
        given=given,
        at_bounds=() if given else at_bounds(study, trial.parameters),
        default_lost=by_validation.default_lost if by_validation and default is None else 0,
        effects=by_validation.effects if by_validation is not None else None,
        claim=claimed(study, tuned),
        default_claim=NO_CLAIM if default is None else claimed(study, default),
        standstill=by_validation is not None and by_validation.standstill,
        of_ended=certificate.deaths is not None,
    )


def _confidences(record: RunRecord) -> Iterator[float]:
    """Yield the confidence of each certificate of a run.

    The shares of the error probability that attempts take add up to no more than the largest of
    the error probabilities asked for.
    """
    for path in certificate_paths(record.path):
        with contextlib.suppress(RunRecordError):
            yield read_certificate(path, record.study).confidence


def _basis(draws: int, with_default: bool, by_validation: Verdict | None, is_result: bool) -> Basis:
    """Return what the verdict by a certificate rests on."""
    if with_default or by_validation is None or not by_validation.observed:
        return Basis(draws, paired=with_default)
    validation = by_validation.observed[0].draws
    return Basis(draws, paired=False, validation=validation, tuned_too=is_result)


def _beside_validation(
    by_validation: Verdict | None, tuned: Observed, is_result: bool
) -> tuple[tuple[Observed, Observed], tuple[Fact, ...] | None]:
    """Return what was observed of both sides if the certificate leaves the default out.

    The pairs are those of the validation of `tune`, which only the result has. Also returns why the
    default was not feasible there; None if it was not evaluated.
    """
    if by_validation is None or not by_validation.observed:
        return (Observed({}, 0), tuned), None
    default, own = by_validation.observed
    beside = replace(tuned, beside=own) if is_result else tuned
    return (default, beside), by_validation.default_reasons


def _observed(
    findings: Findings,
    rows: Sequence[Row],
    name: str,
    draws: int,
    others: Sequence[Mapping[str, float]],
) -> Observed:
    """Return what was observed of a parameter set: in its certificate, and before."""
    own = [row for row in rows if row.parameter_set == name and row.metrics]
    drawn = [row for row in own if row.stage is Stage.VALIDATION]
    return Observed(
        drawn={row.index: row.metrics for row in drawn},
        contexts={row.index: row.context for row in drawn},
        draws=draws,
        source=Source.CERTIFICATE,
        others=[*others, *(row.metrics for row in own if row.stage is not Stage.VALIDATION)],
        worst={
            constraint.name: WorstMean(
                value=worst.mean.value,
                standard_error=worst.mean.standard_error,
                bound=widest(
                    constraint.side, (w.mean.bound(constraint.side) for w in constraint.worst)
                ),
                count=worst.evaluations,
            )
            for constraint in findings.constraints
            for worst in constraint.worst[:1]
        },
    )


def _on_record(record: RunRecord, trial: Trial) -> list[Mapping[str, float]]:
    """Return the metrics that the run itself has of a trial's parameter set."""
    return [
        evaluation.outcome.metrics
        for evaluation in evaluations_of(record.evaluations, trial.parameters)
        if evaluation.outcome.complete
    ]


def _violation(
    study: Study, verdict: ConstraintVerdict, draws: int, confidence: float
) -> ViolationBound:
    of_runs = bool(verdict.worst) and study.constraints[verdict.name].rule.on_runs
    return ViolationBound(
        verdict.violations,
        draws,
        verdict.violation_bound,
        worst=max(c.violation_bound for c in verdict.worst) if of_runs else nan,
        allowed=verdict.allowed,
        confidence=confidence,
    )


def _limits(study: Study, findings: Findings, draws: int) -> dict[str, LimitVerdict]:
    """Return what a certificate says of each limit of a parameter set, by its name."""
    return {
        finding.name: by_certificate(
            study,
            study.constraints[finding.name],
            passed=finding.passed,
            draws=draws,
            violations=finding.violations,
            refuted=finding.refuted,
            condition=finding.assumption,
        )
        for finding in findings.constraints
    }


def _default_limits(by_validation: Verdict) -> dict[str, LimitVerdict]:
    """Return what the validation says of each limit for the default, by its name."""
    return {
        q.constraint: q.default_limit_verdict
        for q in by_validation.quantities
        if q.default_limit_verdict is not None
    }
