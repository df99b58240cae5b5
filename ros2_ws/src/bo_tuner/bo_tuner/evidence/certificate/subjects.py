"""The parameter sets that a certificate is about, with what is known of them."""

from bo_tuner.evidence.certificate.earlier import earlier_evidence
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.storage.record import RunRecord
from bo_tuner.trials import DEFAULT, TUNED, Trial


def subjects_of(
    record: RunRecord, trial: Trial, backend: str, *, with_default: bool
) -> list[Subject]:
    """Return the parameter set of a trial as a subject, after the default if that is asked for."""
    study = record.study
    suspected = tuple(
        trial.worst_cases[constraint.name].context
        for constraint in study.worst_case_constraints
        if constraint.name in trial.worst_cases
    )
    earlier = earlier_evidence(record, trial.parameters, backend)
    tuned = Subject(TUNED, trial.parameters, suspected, earlier)
    if not with_default:
        return [tuned]
    defaults = study.search_space().defaults
    return [Subject(DEFAULT, defaults, earlier=earlier_evidence(record, defaults, backend)), tuned]
