"""The verdict on a parameter set: whether fresh evaluations show that it keeps every constraint.

The burden of proof lies with the parameter set. A constraint counts as kept only if the evaluations
show it with the stated confidence 1 - α; too few evaluations to show it are a FAIL as well.

- A chance constraint (Eq. 3d) is shown to hold if the Clopper-Pearson upper bound of the
  probability that a draw violates it is at most 1 - probability.
- A worst-case constraint (Eq. 3e) is shown to hold if no draw exceeds the limit, as in the
  validation of `tune` (Sec. 5.2), and if, in every candidate for the worst context that a separate
  search finds, the upper bound of the mean over noise is within the limit. The worst case is an
  expectation over noise, as in stage two, so a single noisy evaluation in a corner of the box
  refutes nothing; a draw, from the distribution met in operation, does. Permitting none among n
  draws is a success-run test: it shows a violation probability below 1 - α^(1/n), so more draws are
  a harder test. The tuner leaves a margin for both: in the worst context a single evaluation must
  keep the limit with the constraint's `probability`, 0.85 by default, so the mean there stays about
  one standard deviation below it.
- A failed evaluation counts as a violation of every constraint, and a single one is a FAIL.

PASS requires all of them. Such a test of a union of hypotheses, each at level α, has level α
itself, whatever the dependence between them (Berger 1982): a constraint that in truth does not hold
passes its own test with probability α at most. So no correction for the number of constraints and
candidates is needed. What no test covers is a worst context that the search did not find.

References
----------
Berger (1982). Multiparameter hypothesis testing and acceptance sampling. Technometrics 24(4).
"""

from collections.abc import Sequence

import numpy as np

from bo_tuner.certificate.evidence import TAIL, ConstraintVerdict, Evidence, Findings, WorstContext
from bo_tuner.certificate.risk import (
    conditional_value_at_risk,
    draws_needed,
    is_shown,
    mean_of,
    most_events,
    probability_bound,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parts import MAXIMIZE, WORST_CASE, Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState

PASS, FAIL = "PASS", "FAIL"


def most_draws_needed(study: Study, confidence: float) -> tuple[int, str]:
    """Return the smallest number of draws for a PASS, and the constraint that requires it.

    With fewer, even a sample without any violation cannot show a chance constraint.
    """
    needed = {c.name: draws_needed(c.allowed, confidence) for c in study.chance_constraints}
    if not needed:
        return 1, ""
    name = max(needed, key=lambda key: needed[key])
    return needed[name], name


def judge(study: Study, evidence: Evidence, confidence: float) -> Findings:
    """Judge the evaluations of a parameter set.

    Parameters
    ----------
    study
        The study, whose constraints are judged.
    evidence
        The evaluations; at least one draw.
    confidence
        Confidence of all bounds, between 0 and 1.
    """
    metric = study.objective.metric
    values = _values(evidence.drawn, metric)
    sign = -1.0 if study.objective.direction == MAXIMIZE else 1.0
    failed = [
        evaluation
        for evaluation in evidence.evaluations
        if evaluation.outcome.state is not EvaluationState.COMPLETE
    ]
    return Findings(
        parameters=dict(evidence.parameters),
        objective=mean_of(values, confidence),
        tail=sign * conditional_value_at_risk(sign * values, TAIL),
        evaluations=len(evidence.evaluations),
        failures=len(failed),
        first_failure=_failure(failed[0]) if failed else "",
        constraints=tuple(
            _judge(study, constraint, evidence, confidence)
            for constraint in study.constraints.values()
        ),
    )


def _judge(
    study: Study, constraint: Constraint, evidence: Evidence, confidence: float
) -> ConstraintVerdict:
    values = _values(evidence.drawn, constraint.metric)
    draws, violations = len(evidence.drawn), int(np.sum(values > constraint.upper))
    failures = draws - len(values)
    events = violations + failures
    unit = study.metrics[constraint.metric].unit
    worst: tuple[WorstContext, ...] = ()
    if constraint.kind == WORST_CASE:
        found = [
            _worst_context(evaluations, constraint, confidence) for evaluations in evidence.repeated
        ]
        # A context without a complete evaluation has no mean, and counts as the worst.
        worst = tuple(sorted(found, key=lambda w: -np.nan_to_num(w.mean.value, nan=np.inf)))
        passed, reason = _worst_case(constraint, draws, events, worst, unit)
    else:
        passed, reason = _chance(constraint, draws, events, confidence)
    return ConstraintVerdict(
        name=constraint.name,
        kind=constraint.kind,
        metric=constraint.metric,
        unit=unit,
        limit=constraint.upper,
        allowed=constraint.allowed,
        draws=draws,
        violations=violations,
        failures=failures,
        violation_bound=probability_bound(events, draws, confidence),
        largest=float(values.max()) if len(values) else float("nan"),
        tail=conditional_value_at_risk(values, TAIL),
        worst=worst,
        passed=passed,
        reason=reason,
    )


def _chance(constraint: Constraint, draws: int, events: int, confidence: float) -> tuple[bool, str]:
    allowed = constraint.allowed
    bound = probability_bound(events, draws, confidence)
    passed = is_shown(events, draws, allowed, confidence)
    most = most_events(draws, allowed, confidence)
    if most >= 0:
        rule = f"at most {most} may"
    else:
        rule = f"{draws_needed(allowed, confidence)} draws without any are needed"
    return passed, (
        f"{events} of {draws} draws violate the limit or fail ({rule}): violation probability "
        f"{'at most' if passed else 'may be'} {bound:.4f}, allowed {allowed:.4g}"
    )


def _worst_case(
    constraint: Constraint,
    draws: int,
    events: int,
    worst: Sequence[WorstContext],
    unit: str,
) -> tuple[bool, str]:
    if events:
        return False, f"{events} of {draws} draws violate the limit or fail (none may)"
    if not worst:
        return False, "no candidate for the worst context was evaluated"
    if failures := sum(w.failures for w in worst):
        return False, f"{failures} evaluations failed in the worst contexts (none may)"
    # The context with the largest mean need not have the largest bound.
    top = max(worst, key=lambda w: w.mean.upper)
    passed = top.mean.upper <= constraint.upper
    where = ", ".join(f"{name} {value:.4g}" for name, value in top.context.items()) or "always"
    return passed, (
        f"none of {draws} draws violates the limit; mean over noise in the worst context ({where}) "
        f"{'at most' if passed else 'may be'} {top.mean.upper:.4g}, limit {constraint.upper:g} "
        f"{unit}".rstrip()
    )


def _worst_context(
    evaluations: Sequence[Evaluation], constraint: Constraint, confidence: float
) -> WorstContext:
    values = _values(evaluations, constraint.metric)
    return WorstContext(
        context=dict(evaluations[0].context),
        mean=mean_of(values, confidence),
        largest=float(values.max()) if len(values) else float("nan"),
        evaluations=len(values),
        above=int(np.sum(values > constraint.upper)),
        failures=len(evaluations) - len(values),
    )


def _values(evaluations: Sequence[Evaluation], metric: str) -> Array:
    return np.array(
        [
            evaluation.outcome.metrics[metric]
            for evaluation in evaluations
            if evaluation.outcome.state is EvaluationState.COMPLETE
        ]
    )


def _failure(evaluation: Evaluation) -> str:
    context = ", ".join(f"{name} {value:.4g}" for name, value in evaluation.context.items())
    return f"{evaluation.outcome.reason} (context {context or 'none'}; seed {evaluation.seed})"
