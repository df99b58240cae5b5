"""When the evidence so far decides a limit: it is shown, or a PASS is out of reach.

The rules are those of the verdict (`judgement`), after each evaluation.
"""

from collections.abc import Sequence

from bo_tuner.evidence.certificate.findings import NOTHING, Earlier, Evidence
from bo_tuner.evidence.certificate.limited_runs import (
    drawn_runs,
    failed_runs,
    runs_in_context,
    runs_of,
)
from bo_tuner.evidence.limit_proof import Runs, proof_of
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.noiseless import Noisy, noise_in
from bo_tuner.study.ranges import OutOfRange, outside
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation


def decide_draws(
    study: Study,
    drawn: Sequence[Evaluation],
    most: int,
    confidence: float,
    earlier: Earlier = NOTHING,
) -> bool | None:
    """Return whether the draws so far decide the verdict: True or False; None if not yet."""
    if failed_runs(drawn):
        return False if is_failed(drawn) else None
    if contradiction(study, drawn):
        return False
    undecided = contradicted = False
    for constraint in study.constraints.values():
        rule, runs = constraint.rule, drawn_runs(study, constraint, drawn, earlier)
        if rule.in_every_context:
            if refutes(constraint, runs, confidence):
                return False
            contradicted = contradicted or contradicts_earlier(constraint, earlier.drawn, drawn)
        elif shows(constraint, runs, confidence):
            contradicted = contradicted or contradicts_earlier(constraint, earlier.drawn, drawn)
        elif _is_hopeless(constraint, runs, most, confidence):
            return False
        else:
            undecided = True
    if contradicted and len(drawn) >= most:
        return False
    return None if undecided or contradicted else True


def decide_context(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    place: int,
    most: int,
    confidence: float,
) -> bool | None:
    """Return whether a worst-case constraint holds in a context: True or False; None if open."""
    repeated = evidence.repeated[place]
    if failed_runs(repeated):
        return False if is_failed(repeated) else None
    if contradiction(study, repeated):
        return False
    runs = runs_in_context(study, constraint, repeated, evidence)
    if refutes(constraint, runs, confidence):
        return False
    if shows(constraint, runs, confidence):
        earlier = evidence.earlier.at(repeated[0].context)
        return None if contradicts_earlier(constraint, earlier, repeated) else True
    return False if _is_hopeless(constraint, runs, most, confidence) else None


def shows(constraint: Constraint, runs: Runs, confidence: float) -> bool:
    """Return whether runs show a limit; the only one of a context shows all without noise."""
    if runs.exact:
        return len(runs.events) > 0 and not any(runs.events)
    return proof_of(constraint).is_shown(runs, confidence)


def refutes(constraint: Constraint, runs: Runs, confidence: float) -> bool:
    """Return whether runs refute a limit."""
    return any(runs.events) if runs.exact else proof_of(constraint).is_refuted(runs, confidence)


def _is_hopeless(constraint: Constraint, runs: Runs, most: int, confidence: float) -> bool:
    """Return whether runs cannot show a limit any more, up to `most` of them."""
    if runs.exact:
        return any(runs.events)
    return proof_of(constraint).is_hopeless(runs, most, confidence)


def is_failed(evaluations: Sequence[Evaluation]) -> bool:
    """Return whether failed evaluations decide the verdict: a FAIL.

    Those lost or disturbed at the end can be followed by more, which end it without a verdict.
    """
    return bool(failed_runs(evaluations)) and not evaluations[-1].outcome.unusable


def is_refuted_by(
    constraint: Constraint, evaluations: Sequence[Evaluation], confidence: float
) -> bool:
    """Return whether runs in one context refute that a constraint holds there.

    A failed one is a violation of every constraint.
    """
    return bool(failed_runs(evaluations)) or proof_of(constraint).is_refuted(
        runs_of(constraint, evaluations), confidence
    )


def contradiction(study: Study, evaluations: Sequence[Evaluation]) -> OutOfRange | Noisy | None:
    """Return how evaluations of a certificate contradict what the study declares; None if not."""
    return outside(study.metrics, evaluations) or noise_in(study, evaluations)


def contradicts_earlier(
    constraint: Constraint, earlier: Sequence[Evaluation], fresh: Sequence[Evaluation]
) -> bool:
    """Return whether earlier runs and fresh ones together break the limit; not without earlier."""
    if not earlier:
        return False
    return proof_of(constraint).contradicts(together(constraint, earlier, fresh))


def together(
    constraint: Constraint, earlier: Sequence[Evaluation], fresh: Sequence[Evaluation]
) -> float:
    """Return what is limited in earlier and fresh runs together."""
    return proof_of(constraint).together(runs_of(constraint, [*earlier, *fresh]))
