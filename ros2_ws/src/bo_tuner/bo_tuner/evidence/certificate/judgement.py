"""The verdict on a parameter set: whether fresh evaluations show that it keeps every constraint.

The burden of proof lies with the parameter set. A constraint counts as kept only if the evaluations
show it with the stated confidence 1 - α; too few evaluations to show it are a FAIL as well.

- A constraint over the contexts (Eq. 3d) is shown to hold by draws.
- A constraint in every context (Eq. 3e) is shown to hold if it is in every candidate for the worst
  context that a separate search finds. Draws can only refute it: what holds in every context holds
  there.
- What shows a limit in runs is said by its kind (`bo_tuner.evidence.limit_proof`): the bound of the
  probability of a violation is at most what is allowed, or that of the mean is within the limit.
- A value outside the declared range of its metric is a FAIL: the declaration is wrong.
- A failed evaluation counts as a violation of every constraint, and a single one is a FAIL.

Runs that were made before, in earlier certificates and in the tuning run, count against a PASS and
never for it: what the fresh ones show alone, all of them together must not contradict. Draws are
held against draws, and runs in a context against those in the same context. This makes a PASS
rarer, so every level stays valid, however the earlier runs were chosen.

The bounds of `bo_tuner.numerics.sequential` hold after every evaluation at once, so the evaluations
end as soon as the verdict is clear, and going on cannot turn luck into a PASS.

PASS requires all of them. Such a test of a union of hypotheses, each at level α, has level α
itself, whatever the dependence between them (Berger 1982): a constraint that in truth does not hold
passes its own test with probability α at most. So no correction for the number of constraints and
candidates is needed. What no test covers is a worst context that the search did not find; of
discrete contexts every combination is a candidate.

References
----------
Berger (1982). Multiparameter hypothesis testing and acceptance sampling. Technometrics 24(4).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.evidence.certificate.decisions import (
    contradiction,
    contradicts_earlier,
    refutes,
    shows,
    together,
)
from bo_tuner.evidence.certificate.findings import (
    TAIL,
    ConstraintVerdict,
    Evidence,
    Failure,
    Findings,
    WorstContext,
)
from bo_tuner.evidence.certificate.limited_runs import (
    declared_range,
    drawn_runs,
    failed_runs,
    is_exact,
    runs_in_context,
    values_of,
)
from bo_tuner.evidence.certificate.risk import Mean, conditional_value_at_risk, mean_of
from bo_tuner.evidence.estimates import Estimate, Source, of_draws
from bo_tuner.evidence.limit_proof import ProofByMean, Runs, proof_of
from bo_tuner.evidence.reasons import Assumption, Reason, Why
from bo_tuner.numerics.sequential import probability_bounds
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation


def most_draws_needed(study: Study, confidence: float) -> tuple[int, str]:
    """Return the smallest number of draws for a PASS, and the constraint that requires it.

    With fewer, even a sample far within a limit cannot show it. One in every context takes as many
    runs in each, of which there are at most as many as draws.
    """
    needed = {
        c.name: proof_of(c).fewest(declared_range(study, c), confidence)
        for c in study.constraints.values()
        if not is_exact(study, c)
    }
    if not needed:
        return 1, ""
    name = max(needed, key=lambda key: needed[key])
    return needed[name], name


def least_evaluations(study: Study, confidence: float) -> int:
    """Return the fewest runs that show all limits: none beyond, no search, one worst context."""
    drawn, repeated = 0, 0
    for constraint in study.constraints.values():
        fewest = 1
        if not is_exact(study, constraint):
            fewest = proof_of(constraint).fewest(declared_range(study, constraint), confidence)
        if constraint.rule.in_every_context:
            repeated = max(repeated, fewest)
        else:
            drawn = max(drawn, fewest)
    return drawn + repeated


def judge(study: Study, evidence: Evidence, confidence: float) -> Findings:
    """Judge the evaluations of a parameter set."""
    metric = study.objective.metric
    values = values_of(evidence.drawn, metric)
    sign = study.objective.sign
    failed = failed_runs(evidence.evaluations)
    return Findings(
        parameters=dict(evidence.parameters),
        objective=_objective(study, evidence.drawn),
        tail=sign * conditional_value_at_risk(sign * values, TAIL),
        evaluations=len(evidence.evaluations),
        failures=len(failed),
        first_failure=_failure(failed[0]) if failed else None,
        contradiction=contradiction(study, evidence.evaluations),
        least=least_evaluations(study, confidence),
        constraints=tuple(
            _judge(study, constraint, evidence, confidence)
            for constraint in study.constraints.values()
        ),
    )


def _objective(study: Study, drawn: Sequence[Evaluation]) -> Estimate:
    metric = study.objective.metric
    complete = {k: e for k, e in enumerate(drawn) if e.outcome.complete}
    return of_draws(
        {k: e.outcome.metrics[metric] for k, e in complete.items()},
        {k: e.context for k, e in complete.items()},
        len(drawn),
        study.context_space(),
        Source.CERTIFICATE,
    )


def _judge(
    study: Study, constraint: Constraint, evidence: Evidence, confidence: float
) -> ConstraintVerdict:
    runs = drawn_runs(study, constraint, evidence.drawn, evidence.earlier)
    worst: tuple[WorstContext, ...] = ()
    against = _earlier_draws(constraint, evidence.earlier.drawn, evidence.drawn)
    refuted = refutes(constraint, runs, confidence)
    if constraint.rule.in_every_context:
        worst, refuting, passed, reason = _in_every_context(
            study, constraint, evidence, confidence, against, refuted_by_draws=refuted
        )
        refuted = refuted or refuting
    else:
        shown = shows(constraint, runs, confidence)
        passed = shown and against is None
        if shown and against is not None:
            reason = against
        elif runs.exact:
            reason = Reason(Why.WITHOUT_NOISE)
        else:
            reason = proof_of(constraint).by_draws(runs, confidence)
    values, draws = runs.values, len(evidence.drawn)
    return ConstraintVerdict(
        name=constraint.name,
        kind=constraint.kind,
        metric=constraint.metric,
        unit=study.metrics[constraint.metric].unit,
        limit=constraint.limit,
        side=constraint.side,
        allowed=constraint.allowed,
        draws=draws,
        violations=int(np.sum(constraint.violations(values))),
        failures=draws - len(values),
        violation_bound=_bound(runs, confidence),
        extreme=constraint.farthest(values),
        tail=constraint.sign * conditional_value_at_risk(constraint.sign * values, TAIL),
        worst=worst,
        assumption=_assumption(study, constraint, evidence),
        refuted=refuted,
        passed=passed,
        reason=reason,
    )


def _in_every_context(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    confidence: float,
    against: Reason | None,
    *,
    refuted_by_draws: bool,
) -> tuple[tuple[WorstContext, ...], bool, bool, Reason]:
    """Return the contexts that may be the worst, whether one refutes the limit, and the verdict."""
    everywhere = [
        _worst_context(study, place, constraint, evidence, confidence)
        for place in range(len(evidence.repeated))
    ]
    # A context without a complete evaluation has no mean, and counts as the worst.
    sign = constraint.sign
    worst = tuple(sorted(everywhere, key=lambda w: -np.nan_to_num(sign * w.mean.value, nan=np.inf)))
    refuting = [
        context
        for context, evaluations in zip(everywhere, evidence.repeated, strict=True)
        if refutes(
            constraint, runs_in_context(study, constraint, evaluations, evidence), confidence
        )
    ]
    decided = refuting or failed_runs(evidence.evaluations)
    if constraint.name in evidence.unseen and not decided:
        # Those that were run are the worst ones of other limits.
        worst = ()
    if refuted_by_draws:
        return worst, bool(refuting), False, Reason(Why.DRAWS)
    not_run = evidence.unvisited.get(constraint.name, 0)
    passed, reason = _worst_case(constraint, worst, refuting, against, not_run)
    return worst, bool(refuting), passed, reason


def _worst_case(
    constraint: Constraint,
    worst: Sequence[WorstContext],
    refuting: Sequence[WorstContext],
    against: Reason | None,
    not_run: int,
) -> tuple[bool, Reason]:
    if not worst:
        return False, Reason(Why.NOT_RUN, not_run=not_run)
    if any(w.failures for w in worst):
        return False, Reason(Why.FAILED)
    passed = all(w.shown for w in worst)
    if passed and not_run:
        return False, Reason(Why.NOT_RUN, not_run=not_run)
    if passed and against is not None:
        return False, against
    doubted = [place for place, w in enumerate(worst) if w.contradicted]
    if doubted and all(w.shown or w.contradicted for w in worst):
        return False, Reason(Why.EARLIER_IN_CONTEXT, place=doubted[0])
    return passed, proof_of(constraint).in_contexts(worst, refuting)


def _worst_context(
    study: Study, place: int, constraint: Constraint, evidence: Evidence, confidence: float
) -> WorstContext:
    """Return what the runs in a context show."""
    evaluations = evidence.repeated[place]
    runs = runs_in_context(study, constraint, evaluations, evidence)
    earlier, values = evidence.earlier.at(evaluations[0].context), runs.values
    shown = len(values) == len(evaluations) and shows(constraint, runs, confidence)
    contradicted = shown and contradicts_earlier(constraint, earlier, evaluations)
    return WorstContext(
        context=dict(evaluations[0].context),
        mean=_mean(constraint, runs, confidence),
        extreme=constraint.farthest(values),
        evaluations=len(values),
        beyond=int(np.sum(constraint.violations(values))),
        failures=len(evaluations) - len(values),
        violation_bound=_bound(runs, confidence),
        shown=shown and not contradicted,
        needs_range=not runs.exact and proof_of(constraint).needs_range(runs),
        contradicted=contradicted,
        earlier=len(earlier),
        together=together(constraint, earlier, evaluations) if earlier else float("nan"),
    )


def _mean(constraint: Constraint, runs: Runs, confidence: float) -> Mean:
    """Return the mean with its bounds; on the side of a limit on it, with the one that decides."""
    proof = proof_of(constraint)
    if runs.exact and len(runs.values):
        value = float(runs.values[0])
        return Mean(value, 0.0, upper=value, lower=value)
    mean = mean_of(runs.values, confidence)
    if not isinstance(proof, ProofByMean) or len(runs.values) < 2:
        return mean
    bound = proof.bound(runs, confidence)
    return replace(mean, upper=bound) if constraint.sign > 0.0 else replace(mean, lower=bound)


def _earlier_draws(
    constraint: Constraint, earlier: Sequence[Evaluation], fresh: Sequence[Evaluation]
) -> Reason | None:
    """Return that earlier draws and fresh ones together break the limit; None if they do not."""
    if not contradicts_earlier(constraint, earlier, fresh):
        return None
    both = together(constraint, earlier, fresh)
    return Reason(Why.EARLIER, earlier=len(earlier), together=both)


def _bound(runs: Runs, confidence: float) -> float:
    """Return the upper bound of the probability that a run violates the limit or fails."""
    if not len(runs.events):
        return 1.0
    if runs.exact:
        return float(any(runs.events))
    return float(probability_bounds(runs.events, confidence)[-1])


def _assumption(study: Study, constraint: Constraint, evidence: Evidence) -> Assumption | None:
    title = study.metrics[constraint.metric].title
    if is_exact(study, constraint):
        return Assumption(title, len(evidence.repeats))
    assumed = proof_of(constraint).assumes_noise(declared_range(study, constraint))
    return Assumption(title) if assumed else None


def _failure(evaluation: Evaluation) -> Failure:
    return Failure(evaluation.outcome.reason, evaluation.context, evaluation.seed)
