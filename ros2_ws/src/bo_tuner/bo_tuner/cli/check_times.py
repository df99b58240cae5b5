"""How long a study and the proof of its result take, by test runs that `check` has made."""

from collections.abc import Sequence

from bo_tuner.backends.ros.safe_state import parks_after_runs
from bo_tuner.evidence.certificate.certification import most_evaluations
from bo_tuner.evidence.certificate.draws import least_draws
from bo_tuner.evidence.certificate.judgement import least_evaluations
from bo_tuner.evidence.certificate.outlook import probable_certificate
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.evidence.check import CertificateTime, Ramp, Start, StudyTime
from bo_tuner.evidence.next_drive import asked_of, least_drives
from bo_tuner.methods.registry import METHODS, method_of
from bo_tuner.numerics.sequential import spent
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNED, Evaluation


def evaluations_at_most(study: Study) -> tuple[int, int]:
    """Return the largest numbers of evaluations of a study and of the certificate of its result."""
    tuning = METHODS[method_of(study)].most_evaluations(study)
    # A trial has a suspected context for each worst-case limit.
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    suspected = (nominal,) * len(study.worst_case_constraints)
    subject = Subject(TUNED, study.search_space().defaults, suspected)
    draws = required_draws(study, study.certificate.confidence)
    certificate = most_evaluations(study, [subject], draws).total
    # The first run of all is made once more if it is to have no noise.
    tuning += 2 * study.budget.validation_draws + study.is_noiseless
    return tuning, certificate


def time_of(study: Study, complete: Sequence[Evaluation]) -> StudyTime:
    """Return how long tuning and certificate will take, by test runs that completed."""
    notes = [e.outcome.notes for e in complete]
    starting = sum(n.start_seconds for n in notes)
    rested = max(n.rested_seconds for n in notes)
    waiting = starting + sum(n.rested_seconds + n.ramped_seconds for n in notes)
    of_run = (sum(e.seconds for e in complete) - waiting) / len(complete)
    ramp = _ramp(study)
    each = of_run + rested + (0.0 if ramp is None else ramp.in_a_run * ramp.seconds)
    if study.relative_metrics:
        each *= 2.0
    warm_ups, warm_up = notes[0].warm_ups, notes[0].warm_up_seconds
    start = Start(starting, *_brought_up(study), _starts_each_time(study)) if starting else None
    most, of_certificate = evaluations_at_most(study)
    sets = min(most, study.budget.trials)

    def time(evaluations: int, sets: int) -> float:
        starts = 0 if start is None else evaluations if start.each_run else sets
        return evaluations * each + starts * starting + warm_up

    seconds = time(most, sets)
    if ramp is not None and not ramp.in_a_run:
        seconds += sets * ramp.seconds
    certificate, drives = None, None
    level = spent(study.certificate.confidence, 1)
    if study.plays_bags:
        drives = least_drives(asked_of(study), level)
    else:
        probable = probable_certificate(study)
        low, high = (0, 0) if probable is None else (probable.low, probable.high)
        certificate = CertificateTime(
            probable,
            time(low, 1),
            time(high, 1),
            max(least_evaluations(study, level), least_draws(study)),
            of_certificate,
            time(of_certificate, 1),
        )
    return StudyTime(
        of_run=of_run,
        rested=rested,
        ramp=ramp,
        warm_ups=warm_ups,
        warm_up=warm_up,
        with_default=bool(study.relative_metrics),
        start=start,
        most=most,
        seconds=seconds,
        drives=drives,
        certificate=certificate,
    )


def _ramp(study: Study) -> Ramp | None:
    seconds = None if study.run is None else study.run.ramp
    if seconds is None:
        return None
    # The default beside a run, or the safe parameters after it, change them even within a trial.
    return Ramp(seconds, 2 if parks_after_runs(study) else 1 if study.relative_metrics else 0)


def _brought_up(study: Study) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the nodes that take values while they start, and those while they are configured."""
    start: list[str] = []
    configure: list[str] = []
    for key, spec in study.nodes.items():
        if any(spec.names_in_braces):
            start.append(key)
        elif key in study.start_names:
            (configure if spec.reconfigure else start).append(key)
    return tuple(start), tuple(configure)


def _starts_each_time(study: Study) -> bool:
    """Whether a node takes contexts or seeds only while it starts, as it does the parameters."""
    in_braces = {name for spec in study.nodes.values() for _, name in spec.names_in_braces}
    if in_braces & study.contexts.keys():
        return True
    targets = [(item.node, item.parameter) for item in study.contexts.values()]
    if study.seed_parameter is not None:
        targets.append((study.seed_parameter.node, study.seed_parameter.parameter))
    return any(name in study.start_names.get(node, ()) for node, name in targets)
