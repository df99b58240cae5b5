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

from bo_tuner import text
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
from bo_tuner.evidence.words.limit_kinds import words_of
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
        first_failure=_failure(failed[0]) if failed else "",
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
    rule, unit = constraint.rule, study.metrics[constraint.metric].unit
    runs = drawn_runs(study, constraint, evidence.drawn, evidence.earlier)
    worst: tuple[WorstContext, ...] = ()
    assumption, condition = _assumption(study, constraint, evidence)
    bound = _bound(runs, confidence)
    against = _said_of_draws(constraint, evidence.earlier.drawn, evidence.drawn)
    refuted = refutes(constraint, runs, confidence)
    if rule.in_every_context:
        worst, refuting, passed, reason = _in_every_context(
            study, constraint, evidence, runs, unit, confidence, against
        )
        refuted = refuted or refuting
    else:
        shown = shows(constraint, runs, confidence)
        passed = shown and not against
        reason_of_draws = words_of(constraint).said_of_draws(runs, unit, confidence, passed=passed)
        if runs.exact:
            reason_of_draws = (
                f"{sum(runs.events)} of {text.counted(len(runs.events), 'run')} violate the limit "
                "or fail, and there is neither noise nor another context"
            )
        reason = against if shown and against else reason_of_draws
    values, draws = runs.values, len(evidence.drawn)
    return ConstraintVerdict(
        name=constraint.name,
        kind=constraint.kind,
        metric=constraint.metric,
        unit=unit,
        limit=constraint.limit,
        side=constraint.side,
        allowed=constraint.allowed,
        draws=draws,
        violations=int(np.sum(constraint.violations(values))),
        failures=draws - len(values),
        violation_bound=bound,
        extreme=constraint.farthest(values),
        tail=constraint.sign * conditional_value_at_risk(constraint.sign * values, TAIL),
        worst=worst,
        assumption=assumption,
        condition=condition,
        refuted=refuted,
        passed=passed,
        reason=reason,
    )


def _in_every_context(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    drawn: Runs,
    unit: str,
    confidence: float,
    against: str,
) -> tuple[tuple[WorstContext, ...], bool, bool, str]:
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
    passed, reason = _worst_case(
        constraint,
        drawn.events,
        worst,
        unit,
        refuted_by_draws=refutes(constraint, drawn, confidence),
        against=against,
        refuting=refuting,
        unvisited=evidence.unvisited.get(constraint.name, 0),
    )
    return worst, bool(refuting), passed, reason


def _worst_case(
    constraint: Constraint,
    events: Sequence[bool],
    worst: Sequence[WorstContext],
    unit: str,
    *,
    refuted_by_draws: bool,
    against: str,
    refuting: Sequence[WorstContext],
    unvisited: int,
) -> tuple[bool, str]:
    if refuted_by_draws:
        return False, (
            f"{sum(events)} of {len(events)} draws violate the limit or fail: more than a limit "
            "allows that is kept in every context"
        )
    contexts = text.counted(unvisited, "context")
    not_run = f"{contexts} that may be the worst had no run, as another one had decided"
    if not worst:
        return False, not_run if unvisited else "its worst contexts were not run"
    if failures := sum(w.failures for w in worst):
        failed = text.counted(failures, "test run")
        return False, f"{failed} failed in the worst contexts (none is allowed)"
    passed = all(w.shown for w in worst)
    if passed and unvisited:
        return False, not_run
    if passed and against:
        return False, against
    doubted = [w for w in worst if w.contradicted]
    if doubted and all(w.shown or w.contradicted for w in worst):
        return False, _said_of_both(constraint, doubted[0])
    return passed, words_of(constraint).said_of_contexts(worst, refuting, unit, passed=passed)


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


def _said_of_draws(
    constraint: Constraint,
    earlier: Sequence[Evaluation],
    fresh: Sequence[Evaluation],
) -> str:
    """Say that earlier draws and fresh ones together break the limit; empty if they do not."""
    if not contradicts_earlier(constraint, earlier, fresh):
        return ""
    both = f"{len(earlier)} earlier draws, which count against it, and {len(fresh)} fresh ones"
    return words_of(constraint).said_together(both, together(constraint, earlier, fresh))


def _said_of_both(constraint: Constraint, worst: WorstContext) -> str:
    inside = text.values(worst.context)
    where = f" in a context ({inside})" if inside else ""
    fresh = worst.evaluations + worst.failures
    both = f"{worst.earlier} earlier runs{where}, which count against it, and {fresh} fresh ones"
    return words_of(constraint).said_together(both, worst.together)


def _bound(runs: Runs, confidence: float) -> float:
    """Return the upper bound of the probability that a run violates the limit or fails."""
    if not len(runs.events):
        return 1.0
    if runs.exact:
        return float(any(runs.events))
    return float(probability_bounds(runs.events, confidence)[-1])


def _assumption(study: Study, constraint: Constraint, evidence: Evidence) -> tuple[str, str]:
    """Return on what the evidence rests besides its number, and briefly; empty if on nothing."""
    if is_exact(study, constraint):
        return (
            "the study declares its runs free of noise (noise: none), of which "
            f"{text.counted(len(evidence.repeats), 'run')} with another seed had the same metrics",
            "its runs are free of noise, as declared",
        )
    return proof_of(constraint).assumption(declared_range(study, constraint))


def _failure(evaluation: Evaluation) -> str:
    context = text.values(evaluation.context) or "none"
    return f"{evaluation.outcome.reason} (context {context}; seed {evaluation.seed})"
