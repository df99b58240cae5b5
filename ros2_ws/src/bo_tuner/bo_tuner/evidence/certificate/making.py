"""Makes the certificate of a parameter set of its evidence."""

import hashlib
import json
import math
from collections.abc import Mapping
from datetime import datetime

from bo_tuner.codec.checks import same_value
from bo_tuner.evidence.busy import HighLoad, high_load
from bo_tuner.evidence.certificate.certificate import Certificate, CertifiedObjective
from bo_tuner.evidence.certificate.context_tolerance import context_tolerances
from bo_tuner.evidence.certificate.deaths import deaths_in
from bo_tuner.evidence.certificate.evaluations_file import evaluations_csv
from bo_tuner.evidence.certificate.findings import Evidence, Findings
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.parameter_sensitivity import parameter_sensitivity
from bo_tuner.evidence.certificate.search_width import SearchWidth, search_widths
from bo_tuner.evidence.certificate.store import parameters_sha256
from bo_tuner.evidence.certificate.winners_curse import training_gaps
from bo_tuner.evidence.declarations import drifts, two_kinds, uneven
from bo_tuner.numerics.sequential import spent
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.in_force import in_force
from bo_tuner.study.measured import seen_in
from bo_tuner.study.parts import ROS
from bo_tuner.study.study import Study
from bo_tuner.trials import DEFAULT, TUNED, Stage, Trial, Value, evaluations_of
from bo_tuner.tuning.recorded_method import recorded_method


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
    """Judge the evidence, and compare it with the estimates of the run."""
    study, ranking = record.study, recorded_method(record).ranking
    tuned = evidence[TUNED]
    level = spent(confidence, attempt, len(evidence))
    findings = judge(study, tuned, level)
    trials = recorded_method(record).checked(study, record.trials, record.evaluations)
    surrogates = ranking.models(study, trials)
    ranked = ranking.ranked_by(surrogates, study, trials)
    predicted = next((c.objective for c in ranked if c.trial.number == trial.number), math.nan)
    in_training = evaluations_of(record.evaluations, trial.parameters)
    # Draws come last: beyond the most that the model takes they add the least.
    fresh = [
        evaluation for evaluation in tuned.evaluations if evaluation.stage is not Stage.VALIDATION
    ]
    others = [e for e in record.evaluations if e.parameter_set != trial.parameter_set]
    others += evidence[DEFAULT].evaluations if DEFAULT in evidence else ()
    deaths = deaths_in(study, tuned.evaluations, others, level)
    made_by = provenance(study, backend, record.algorithm)
    metric = study.metrics[study.objective.metric]
    drawn = {name: item.drawn for name, item in evidence.items()}
    return Certificate(
        study=study.name,
        study_sha256=made_by["study_sha256"],
        trial=trial.number,
        parameters_sha256=parameters_sha256(tuned.parameters),
        held=_held(study, tuned),
        seen=seen_in(study.measured, tuned.evaluations),
        best_yaml_sha256=best_sha256,
        evaluations_sha256=_sha256(evaluations_csv(evidence, study.contexts, study.metrics)),
        draws=draws,
        drawn=len(tuned.drawn),
        confidence=confidence,
        attempt=attempt,
        bound_confidence=level,
        contexts={name: item.unit for name, item in study.contexts.items()},
        metrics={name: item.unit for name, item in study.metrics.items()},
        objective=CertifiedObjective(metric.name, metric.unit, study.objective.direction),
        tuned=findings,
        default=judge(study, evidence[DEFAULT], level) if DEFAULT in evidence else None,
        earlier=tuned.earlier.in_brief,
        search_widths=_widths(study, tuned),
        training_gaps=training_gaps(study, trial, predicted, findings),
        context_tolerances=context_tolerances(study, [*fresh, *in_training, *tuned.drawn]),
        parameter_sensitivity=parameter_sensitivity(study, trial.parameters, surrogates),
        deaths=deaths,
        in_force=in_force(study) if backend == ROS else (),
        high_load=_busy(study, findings, tuned),
        drifts=tuple(drifts(study, drawn)),
        two_kinds=tuple(two_kinds(study, drawn)),
        uneven=tuple(uneven(study, tuned.evaluations)),
        provenance=made_by,
        finished=datetime.now().astimezone().isoformat(timespec="seconds"),
    )


def _busy(study: Study, findings: Findings, evidence: Evidence) -> HighLoad | None:
    """Return how busy the computer was in runs of limits on times that were not shown."""
    open_limits = (study.constraints[c.name] for c in findings.constraints if not c.passed)
    titles = {study.metrics[constraint.metric].title for constraint in open_limits}
    high = high_load(study, evidence.evaluations)
    return high if high is not None and titles & set(high.metrics) else None


def _widths(study: Study, evidence: Evidence) -> tuple[SearchWidth, ...]:
    """Return which violations the search met: with its own runs, not with earlier ones."""
    if not evidence.search:
        return ()
    return search_widths(study.context_space(), [e.context for e in evidence.evaluations])


def _held(study: Study, evidence: Evidence) -> dict[str, float]:
    """Return what devices have of the parameters in place of values with more digits."""
    noted: dict[str, Value] = {}
    for evaluation in evidence.evaluations:
        noted |= evaluation.outcome.notes.held
    held = {}
    for name, item in study.parameters.items():
        reported = noted.get(f"{item.node}.{item.array or item.parameter}")
        if reported is not None:
            held[name] = json.loads(str(reported))[item.item] if item.array else float(reported)
    return {
        name: value
        for name, value in held.items()
        if not same_value(value, evidence.parameters[name])
    }


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
