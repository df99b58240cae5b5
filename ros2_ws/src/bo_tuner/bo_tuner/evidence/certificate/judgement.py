"""The verdict on a parameter set: whether fresh evaluations show that it keeps every constraint.

The burden of proof lies with the parameter set. A constraint counts as kept only if the evaluations
show it with the stated confidence 1 - α; too few evaluations to show it are a FAIL as well.

- A chance constraint (Eq. 3d) is shown to hold if the upper bound of the probability that a draw
  violates it is at most 1 - probability.
- A worst-case constraint (Eq. 3e) is shown to hold if it is in every candidate for the worst
  context that a separate search finds: the upper bound of the mean over noise is within the limit,
  with at least `LEAST_RUNS` runs behind it, or, for a limit on single runs, that of the probability
  of a violation is at most 1 - probability.
  Draws can only refute it: what holds in every context holds there.
- A failed evaluation counts as a violation of every constraint, and a single one is a FAIL.

Runs that were made before, in earlier certificates and in the tuning run, count against a PASS and
never for it: what the fresh ones show alone, all of them together must not contradict. Draws are
held against draws, and runs in a context against those in the same context. This makes a PASS
rarer, so every level stays valid, however the earlier runs were chosen.

The bounds of `sequential` hold after every evaluation at once, so the evaluations end as soon as
the verdict is clear, and going on cannot turn luck into a PASS.

PASS requires all of them. Such a test of a union of hypotheses, each at level α, has level α
itself, whatever the dependence between them (Berger 1982): a constraint that in truth does not hold
passes its own test with probability α at most. So no correction for the number of constraints and
candidates is needed. What no test covers is a worst context that the search did not find.

References
----------
Berger (1982). Multiparameter hypothesis testing and acceptance sampling. Technometrics 24(4).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bo_tuner import text
from bo_tuner.evidence.certificate.economy import (
    FEW,
    confirms,
    is_far_from,
    is_shown_by_all,
    said_of_draws,
)
from bo_tuner.evidence.certificate.findings import (
    NOTHING,
    TAIL,
    ConstraintVerdict,
    Earlier,
    Evidence,
    Findings,
    Ranking,
    WorstContext,
)
from bo_tuner.evidence.certificate.risk import Mean, conditional_value_at_risk, mean_of
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.mean_tests import (
    Betting,
    MeanTest,
    NormalOrSkewed,
    is_mean_shown,
    mean_bound,
)
from bo_tuner.numerics.sequential import (
    draws_needed,
    is_hopeless,
    is_mean_refuted,
    is_refuted,
    is_shown,
    probability_bounds,
)
from bo_tuner.study.constraint import EXPECTATION, SINGLE_RUN, WORST_CASE, Constraint
from bo_tuner.study.ranges import outside
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation

LEAST_RUNS = 30
"""Runs behind a mean that counts as shown. The bound of a mean takes the noise for normal: a few
runs that agree tell nothing of rare large values."""


TAIL_ASSUMPTION = (
    "the noise is taken for normal or log-normal: of such laws with a mean just beyond the limit "
    "at most 1 in 40 passes within five certificates, of rare large values that no run has shown "
    "far more; give the metric a range, or limit single runs (probability)"
)
"""On what a limit on a mean rests if the metric has no range (benchmarks/certificates.py)."""


def most_draws_needed(study: Study, confidence: float) -> tuple[int, str]:
    """Return the smallest number of draws for a PASS, and the constraint that requires it.

    With fewer, even a sample without any violation cannot show a limit on single runs. One in every
    context takes as many runs in each, of which there are at most as many as draws.
    """
    needed = {
        c.name: draws_needed(c.allowed, confidence)
        for c in study.constraints.values()
        if c.statistic == SINGLE_RUN
    }
    if not needed:
        return 1, ""
    name = max(needed, key=lambda key: needed[key])
    return needed[name], name


def least_evaluations(study: Study, confidence: float) -> int:
    """Return the fewest runs that show all limits: none beyond, no search, one worst context."""
    drawn, repeated = [0], [0]
    for constraint in study.constraints.values():
        if constraint.kind != WORST_CASE:
            drawn.append(draws_needed(constraint.allowed, confidence))
        elif constraint.statistic == EXPECTATION:
            sign = constraint.sign
            test, limit = mean_test(study, constraint), sign * constraint.limit
            repeated.append(test.fewest(limit, confidence))
        else:
            repeated.append(draws_needed(constraint.allowed, confidence))
    return max(drawn) + max(repeated)


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
    sign = study.objective.sign
    failed = _failed(evidence.evaluations)
    return Findings(
        parameters=dict(evidence.parameters),
        objective=mean_of(values, confidence),
        tail=sign * conditional_value_at_risk(sign * values, TAIL),
        evaluations=len(evidence.evaluations),
        failures=len(failed),
        first_failure=_failure(failed[0]) if failed else "",
        outside=outside(study.metrics, evidence.evaluations),
        least=least_evaluations(study, confidence),
        constraints=tuple(
            _judge(study, constraint, evidence, confidence)
            for constraint in study.constraints.values()
        ),
    )


def decide_draws(
    study: Study,
    drawn: Sequence[Evaluation],
    most: int,
    confidence: float,
    earlier: Earlier = NOTHING,
    others: Sequence[Evaluation] | None = None,
) -> bool | None:
    """Return whether the draws so far decide the verdict: True or False; None if not yet.

    Parameters
    ----------
    study
        The study.
    drawn
        The draws so far, in their order.
    most
        Largest number of draws.
    confidence
        As in `judge`.
    earlier
        What was known of the parameter set before.
    others
        Its other runs, which count where a chance constraint is kept by far; None if they are
        still to come.

    Returns
    -------
    bool or None
        True if they show all chance constraints, and do not leave a worst-case constraint
        contradicted by earlier draws. False if a PASS is out of reach.
    """
    if _failed(drawn):
        return False if is_failed(drawn) else None
    if outside(study.metrics, drawn):
        return False
    undecided = contradicted = False
    for constraint in study.constraints.values():
        events, values = _events(constraint, drawn), _values(drawn, constraint.metric)
        if constraint.kind == WORST_CASE:
            if _refuted(constraint, events, values, confidence):
                return False
            contradicted = contradicted or _contradicted(constraint, earlier.drawn, drawn)
        elif is_shown(events, constraint.allowed, confidence):
            contradicted = contradicted or _contradicted(constraint, earlier.drawn, drawn)
        elif is_hopeless(events, most, constraint.allowed, confidence):
            return False
        else:
            undecided = undecided or not _is_shown_with_others(
                study, constraint, values, others, confidence
            )
    if contradicted and len(drawn) >= most:
        return False
    return None if undecided or contradicted else True


def _is_shown_with_others(
    study: Study,
    constraint: Constraint,
    draws: Array,
    others: Sequence[Evaluation] | None,
    confidence: float,
) -> bool:
    """Return whether other runs show with the draws what is kept by far, or those to come may."""
    if study.certificate.distribution_free:
        return False
    if others is None:
        return bool(study.worst_case_constraints) and is_far_from(constraint, draws, draws[:0])
    if _failed(others):
        return False
    return is_shown_by_all(constraint, draws, _values(others, constraint.metric), confidence)


def decide_context(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    place: int,
    most: int,
    confidence: float,
) -> bool | None:
    """Return whether a worst-case constraint holds in a context: True or False; None if open.

    Parameters
    ----------
    study, constraint
        The study, and one of its constraints.
    evidence
        The evaluations so far, with one at least in the context.
    place
        Index of the context among those of ``evidence.repeated``.
    most, confidence
        As in `decide_draws`.

    Returns
    -------
    bool or None
        True if they show that it holds. False if a PASS is out of reach.
    """
    repeated = evidence.repeated[place]
    if _failed(repeated):
        return False if is_failed(repeated) else None
    if outside(study.metrics, repeated):
        return False
    events, values = _events(constraint, repeated), _values(repeated, constraint.metric)
    if _refuted(constraint, events, values, confidence):
        return False
    if _shown(study, constraint, evidence, events, values, confidence) or _by_model(
        study, constraint, evidence, place, confidence
    ):
        earlier = evidence.earlier.at(repeated[0].context)
        return None if _contradicted(constraint, earlier, repeated) else True
    if constraint.statistic == EXPECTATION:
        return None
    group = _group(constraint, evidence, place)
    if group:
        events = _events(constraint, group)
    return False if is_hopeless(events, most, constraint.allowed, confidence) else None


def is_failed(evaluations: Sequence[Evaluation]) -> bool:
    """Return whether failed evaluations decide the verdict: a FAIL.

    Those lost or disturbed at the end can be followed by more, which end it without a verdict.
    """
    return bool(_failed(evaluations)) and not evaluations[-1].outcome.spoilt


def is_refuted_by(
    constraint: Constraint, evaluations: Sequence[Evaluation], confidence: float
) -> bool:
    """Return whether runs in one context refute that a constraint holds there.

    A failed one is a violation of every constraint.
    """
    events = _events(constraint, evaluations)
    values = _values(evaluations, constraint.metric)
    return bool(_failed(evaluations)) or _refuted(constraint, events, values, confidence)


def _judge(
    study: Study, constraint: Constraint, evidence: Evidence, confidence: float
) -> ConstraintVerdict:
    values = _values(evidence.drawn, constraint.metric)
    draws, violations = len(evidence.drawn), int(np.sum(constraint.violations(values)))
    events = _events(constraint, evidence.drawn)
    unit = study.metrics[constraint.metric].unit
    worst: tuple[WorstContext, ...] = ()
    modelled: tuple[WorstContext, ...] = ()
    assumptions: tuple[str, ...] = ()
    violation_bound = _bound(events, confidence)
    if constraint.kind == WORST_CASE:
        helped = [
            _by_model(study, constraint, evidence, place, confidence)
            for place in range(len(evidence.repeated))
        ]
        everywhere = [
            _worst_context(study, evaluations, constraint, evidence, confidence, by_model=by_model)
            for evaluations, by_model in zip(evidence.repeated, helped, strict=True)
        ]
        aside = [
            w.shown
            and by_model
            and not _shown(
                study,
                constraint,
                evidence,
                _events(constraint, runs),
                _values(runs, constraint.metric),
                confidence,
            )
            for w, by_model, runs in zip(everywhere, helped, evidence.repeated, strict=True)
        ]
        found = [w for w, apart in zip(everywhere, aside, strict=True) if not apart]
        modelled = tuple(w for w, apart in zip(everywhere, aside, strict=True) if apart)
        assumptions = _assumptions(study, constraint, evidence, modelled)
        # A context without a complete evaluation has no mean, and counts as the worst.
        sign = constraint.sign
        worst = tuple(sorted(found, key=lambda w: -np.nan_to_num(sign * w.mean.value, nan=np.inf)))
        refuting = [
            context
            for context, runs in zip(everywhere, evidence.repeated, strict=True)
            if _refuted(
                constraint, _events(constraint, runs), _values(runs, constraint.metric), confidence
            )
        ]
        told = refuting or _failed(evidence.evaluations)
        if constraint.name in evidence.unseen and not told:
            # Those that were run are the worst ones of other limits.
            worst = ()
        passed, reason = _worst_case(
            constraint,
            events,
            worst,
            unit,
            refuted_by_draws=_refuted(constraint, events, values, confidence),
            against=_said_of_draws(constraint, evidence.earlier.drawn, evidence.drawn),
            refuting=refuting,
            unvisited=evidence.unvisited.get(constraint.name, 0),
        )
    else:
        against = _said_of_draws(constraint, evidence.earlier.drawn, evidence.drawn)
        others = _values(evidence.evaluations[draws:], constraint.metric)
        by_all = not (
            study.certificate.distribution_free
            or _failed(evidence.evaluations)
            or is_shown(events, constraint.allowed, confidence)
        ) and is_shown_by_all(constraint, values, others, confidence)
        if by_all:
            violation_bound = _bound([False] * len(evidence.evaluations), confidence)
            assumptions = (said_of_draws(constraint, values, others),)
        passed, reason = _chance(
            constraint, events, violation_bound, confidence, against, others=len(others) * by_all
        )
    return ConstraintVerdict(
        name=constraint.name,
        kind=constraint.kind,
        metric=constraint.metric,
        unit=unit,
        limit=constraint.limit,
        side=constraint.side,
        statistic=constraint.statistic,
        allowed=constraint.allowed,
        draws=draws,
        violations=violations,
        failures=draws - len(values),
        violation_bound=violation_bound,
        extreme=constraint.farthest(values),
        tail=constraint.sign * conditional_value_at_risk(constraint.sign * values, TAIL),
        worst=worst,
        modelled=modelled,
        assumptions=assumptions,
        passed=passed,
        reason=reason,
    )


def _assumptions(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    modelled: Sequence[WorstContext],
) -> tuple[str, ...]:
    """Say on what a worst-case constraint rests besides the counted runs in its worst contexts."""
    said = []
    test = mean_test(study, constraint)
    if constraint.statistic == EXPECTATION and isinstance(test, NormalOrSkewed):
        said.append(TAIL_ASSUMPTION)
    clear = evidence.ranking.get(constraint.name, Ranking()).clear
    far = [w for w in modelled if w.context in clear]
    if far:
        said.append(
            f"in {text.counted(len(far), 'context')} the limit is kept by far by a model over the "
            f"contexts, which {sum(w.evaluations for w in far)} runs confirm"
        )
    behind = [w for w in modelled if w.context not in clear]
    if behind:
        said.append(
            f"{text.counted(len(behind), 'context')} with {sum(w.evaluations for w in behind)} "
            "runs are judged together: by a model over the contexts, none is worse than the worst"
        )
    return tuple(said)


def _chance(
    constraint: Constraint,
    events: Sequence[bool],
    bound: float,
    confidence: float,
    against: str,
    *,
    others: int,
) -> tuple[bool, str]:
    """Judge a chance constraint, by the draws or also by `others` runs that keep the limit."""
    allowed, draws = constraint.allowed, len(events)
    passed = others > 0 or is_shown(events, allowed, confidence)
    if passed and against:
        return False, against
    if others:
        return True, (
            f"none of {draws} draws and {others} other runs violates the limit, which they keep by "
            f"far: violation probability at most {text.shown_beside(bound, allowed)}, allowed "
            f"{allowed:.4g}"
        )
    needed = draws_needed(allowed, confidence)
    rule = "" if draws >= needed else f" ({needed} draws without any are needed)"
    return passed, (
        f"{sum(events)} of {draws} draws violate the limit or fail{rule}: violation probability "
        f"{'at most' if passed else 'may be'} "
        f"{text.shown_beside(bound, allowed)}, allowed {allowed:.4g}"
    )


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
        return False, not_run if unvisited else "its worst contexts were not evaluated"
    if failures := sum(w.failures for w in worst):
        failed = text.counted(failures, "evaluation")
        return False, f"{failed} failed in the worst contexts (none is allowed)"
    passed = all(w.shown for w in worst)
    if passed and unvisited:
        return False, not_run
    if passed and against:
        return False, against
    doubted = [w for w in worst if w.contradicted]
    if doubted and all(w.shown or w.contradicted for w in worst):
        return False, _said_of_both(constraint, doubted[0])
    if constraint.statistic == EXPECTATION:
        return passed, _said_of_mean(constraint, worst, unit, refuting, passed)
    top = max(worst, key=lambda w: w.violation_bound)
    return passed, (
        f"{_place(top, worst)}{top.beyond} of {top.evaluations} runs violate the limit: "
        f"violation probability {'at most' if passed else 'may be'} "
        f"{text.shown_beside(top.violation_bound, constraint.allowed)}, "
        f"allowed {constraint.allowed:.4g}"
    )


def _said_of_mean(
    constraint: Constraint,
    worst: Sequence[WorstContext],
    unit: str,
    refuting: Sequence[WorstContext],
    passed: bool,
) -> str:
    limit = f"limit {constraint.limit:g} {unit}".rstrip()
    # The context with the largest mean need not have the largest bound.
    top = max(worst, key=lambda w: constraint.sign * _mean_bound(constraint, w))
    bound = _mean_bound(constraint, top)
    if refuting and not np.isfinite(bound):
        # It ends the evaluations before the bound of a mean has its runs.
        by = refuting[0]
        inside = text.values(by.context)
        return (
            f"mean over noise {f'in a context ({inside}) ' if inside else ''}is "
            f"{text.shown_beside(by.mean.value, constraint.limit)}, {limit}: "
            f"{by.evaluations} evaluations show that it is not kept"
        )
    where = _place(top, worst)
    if not np.isfinite(bound):
        return f"{top.evaluations} evaluations {where}are too few to bound the mean over noise"
    if not passed and not constraint.violations(bound):
        return (
            f"{sum(w.evaluations for w in worst)} evaluations in the worst contexts say too "
            "little about the noise to show that the mean over it is within the limit"
        )
    says = "may be"
    if passed:
        says = "at most" if constraint.sign > 0.0 else "at least"
    return f"mean over noise {where}{says} {text.shown_beside(bound, constraint.limit)}, {limit}"


def _place(top: WorstContext, worst: Sequence[WorstContext]) -> str:
    """Name a context among the worst ones, with a space at its end; empty if there is but one."""
    context = text.values(top.context)
    which = "the worst context" if top is worst[0] else "the least certain of the worst contexts"
    return f"in {which} ({context}) " if context else ""


def _mean_bound(constraint: Constraint, worst: WorstContext) -> float:
    """Return the confidence bound of a mean on the side of the limit."""
    return worst.mean.upper if constraint.sign > 0.0 else worst.mean.lower


def _worst_context(
    study: Study,
    evaluations: Sequence[Evaluation],
    constraint: Constraint,
    evidence: Evidence,
    confidence: float,
    *,
    by_model: bool,
) -> WorstContext:
    events, values = _events(constraint, evaluations), _values(evaluations, constraint.metric)
    earlier = evidence.earlier.at(evaluations[0].context)
    shown = len(values) == len(evaluations) and (
        _shown(study, constraint, evidence, events, values, confidence) or by_model
    )
    contradicted = shown and _contradicted(constraint, earlier, evaluations)
    return WorstContext(
        context=dict(evaluations[0].context),
        mean=_mean(study, constraint, evidence, values, confidence),
        extreme=constraint.farthest(values),
        evaluations=len(values),
        beyond=int(np.sum(constraint.violations(values))),
        failures=len(evaluations) - len(values),
        violation_bound=_bound(events, confidence),
        shown=shown and not contradicted,
        contradicted=contradicted,
        earlier=len(earlier),
        together=_together(constraint, earlier, evaluations) if earlier else float("nan"),
    )


def _beyond(constraint: Constraint, evaluations: Sequence[Evaluation]) -> bool:
    """Return whether runs, taken for themselves, break the limit."""
    found = _of_all(constraint, evaluations)
    if constraint.statistic == EXPECTATION:
        return bool(constraint.violations(found))
    return found > constraint.allowed


def _contradicted(
    constraint: Constraint, earlier: Sequence[Evaluation], fresh: Sequence[Evaluation]
) -> bool:
    """Return whether earlier runs and fresh ones together break the limit; not without earlier."""
    return bool(earlier) and _beyond(constraint, [*earlier, *fresh])


def _together(
    constraint: Constraint, earlier: Sequence[Evaluation], fresh: Sequence[Evaluation]
) -> float:
    """Return the mean of earlier and fresh runs, or the share of those beyond the limit."""
    return _of_all(constraint, [*earlier, *fresh])


def _of_all(constraint: Constraint, evaluations: Sequence[Evaluation]) -> float:
    """Return the mean of runs, or the share of those beyond the limit."""
    if constraint.statistic != EXPECTATION:
        return float(np.mean(_events(constraint, evaluations)))
    values = _values(evaluations, constraint.metric)
    return float(values.mean()) if len(values) else float("nan")


def _said_of_draws(
    constraint: Constraint,
    earlier: Sequence[Evaluation],
    fresh: Sequence[Evaluation],
) -> str:
    """Say that earlier draws and fresh ones together break the limit; empty if they do not."""
    if not _contradicted(constraint, earlier, fresh):
        return ""
    both = f"{len(earlier)} earlier draws, which count against it, and {len(fresh)} fresh ones"
    return _said_together(constraint, both, _together(constraint, earlier, fresh))


def _said_of_both(constraint: Constraint, worst: WorstContext) -> str:
    inside = text.values(worst.context)
    where = f" in a context ({inside})" if inside else ""
    fresh = worst.evaluations + worst.failures
    both = f"{worst.earlier} earlier runs{where}, which count against it, and {fresh} fresh ones"
    return _said_together(constraint, both, worst.together)


def _said_together(constraint: Constraint, both: str, together: float) -> str:
    if constraint.statistic == EXPECTATION:
        found = text.shown_beside(together, constraint.limit)
        return f"{both} together have a mean of {found}, limit {constraint.limit:g}"
    found = text.shown_beside(together, constraint.allowed)
    return (
        f"{both} together violate the limit with a share of {found}, "
        f"allowed {constraint.allowed:.4g}"
    )


def _by_model(
    study: Study, constraint: Constraint, evidence: Evidence, place: int, confidence: float
) -> bool:
    """Return whether a limit is shown in a context with the help of the model over contexts.

    Either the model has it kept there by far, and a few runs confirm it; or by the model it is not
    the worst, and all runs in such contexts show the limit together, and those of none contradict.
    """
    here, ranking = evidence.repeated[place], evidence.ranking.get(constraint.name)
    values = _values(here, constraint.metric)
    if ranking is None or len(values) < max(FEW, len(here)):
        return False
    if here[0].context in ranking.clear and confirms(constraint, values):
        return True
    group = _group(constraint, evidence, place)
    if not group or _failed(group) or _beyond(constraint, here):
        return False
    return _shown(
        study,
        constraint,
        evidence,
        _events(constraint, group),
        _values(group, constraint.metric),
        confidence,
    )


def _group(constraint: Constraint, evidence: Evidence, place: int) -> list[Evaluation]:
    """Return the runs in all contexts that count together with those in a place; of none, if alone.

    They are in the order in which they were made: one in each context after the other.
    """
    ranking = evidence.ranking.get(constraint.name)
    if ranking is None or evidence.repeated[place][0].context not in ranking.behind:
        return []
    members = [runs for runs in evidence.repeated if runs and runs[0].context in ranking.behind]
    longest = max(map(len, members))
    return [runs[k] for k in range(longest) for runs in members if k < len(runs)]


def _mean(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    values: Array,
    confidence: float,
) -> Mean:
    """Return the mean with its bounds; on the side of a limit on it, with the one that decides."""
    least = _least_runs(constraint, evidence, values)
    found = mean_of(values, confidence, least)
    if constraint.statistic != EXPECTATION or len(values) < 2:
        return found
    sign, test = constraint.sign, mean_test(study, constraint)
    bound = sign * mean_bound(sign * values, confidence, test, least)
    return replace(found, upper=bound) if sign > 0.0 else replace(found, lower=bound)


def mean_test(study: Study, constraint: Constraint) -> MeanTest:
    """Return how a limit on a mean is shown: by the declared range of its metric, if it has one."""
    declared = study.metrics[constraint.metric].range
    if declared is None:
        return NormalOrSkewed()
    low, high = declared
    return Betting(low, high) if constraint.sign > 0.0 else Betting(-high, -low)


def _shown(
    study: Study,
    constraint: Constraint,
    evidence: Evidence,
    events: Sequence[bool],
    values: Array,
    confidence: float,
) -> bool:
    """Return whether runs in a context show a limit there by themselves."""
    if constraint.statistic != EXPECTATION:
        return is_shown(events, constraint.allowed, confidence)
    sign, test = constraint.sign, mean_test(study, constraint)
    least = _least_runs(constraint, evidence, values)
    shown = is_mean_shown(sign * values, sign * constraint.limit, confidence, test, least)
    if isinstance(test, Betting):
        # It is exact for rare values, too.
        return shown
    return shown and _excludes_rare(constraint, evidence, values, confidence)


def _least_runs(constraint: Constraint, evidence: Evidence, values: Array) -> int:
    """Return the number of runs, of those with `values` in a context, that bound its mean first.

    They are `LEAST_RUNS` once any run of the parameter set is beyond the limit, and the first one
    that differs is among them. Before, all its runs count; where those in a context are equal, only
    runs in other contexts where they are, too.
    """
    if constraint.statistic != EXPECTATION:
        # The mean decides nothing; its bound is there for information.
        return 1
    if constraint.violations(_farthest_known(constraint, evidence)):
        return max(LEAST_RUNS, 1 + int(np.argmax(values != values[:1]))) if len(values) else 1
    if not _are_equal(values):
        # No run is beyond the limit, and all of them tell of rare large values.
        return max(1, LEAST_RUNS + len(values) - len(evidence.evaluations))
    contexts = [_values(evaluations, constraint.metric) for evaluations in evidence.repeated]
    alike = sum(len(v) for v in contexts if _are_equal(v) == _are_equal(values))
    return max(1, LEAST_RUNS + len(values) - alike)


def _excludes_rare(
    constraint: Constraint, evidence: Evidence, values: Array, confidence: float
) -> bool:
    """Return whether runs in a context exclude that rare others take its mean beyond the limit.

    If all runs are equal, their mean bounds nothing that does not occur among them. A mean beyond
    the limit needs runs as far as the worst one known with the probability that is tested here.
    """
    worst = _farthest_known(constraint, evidence)
    if not _are_equal(values) or not constraint.violations(worst):
        return True
    rare = float((constraint.limit - values[0]) / (worst - values[0]))
    return is_shown([False] * len(values), rare, confidence)


def _farthest_known(constraint: Constraint, evidence: Evidence) -> float:
    """Return the value of all runs of the parameter set, earlier ones as well, that is farthest."""
    own = _values(evidence.evaluations, constraint.metric)
    return constraint.farthest([*own, *evidence.earlier.extremes.get(constraint.metric, ())])


def _are_equal(values: Array) -> bool:
    return len(values) > 0 and float(np.ptp(values)) == 0.0


def _refuted(
    constraint: Constraint, events: Sequence[bool], values: Array, confidence: float
) -> bool:
    if constraint.statistic == EXPECTATION:
        sign = constraint.sign
        return is_mean_refuted(sign * values, sign * constraint.limit, confidence)
    return is_refuted(events, constraint.allowed, confidence)


def _events(constraint: Constraint, evaluations: Sequence[Evaluation]) -> list[bool]:
    """Return whether each evaluation violates the limit or failed."""
    return [
        not e.outcome.complete or bool(constraint.violations(e.outcome.metrics[constraint.metric]))
        for e in evaluations
    ]


def _bound(events: Sequence[bool], confidence: float) -> float:
    return float(probability_bounds(events, confidence)[-1]) if len(events) else 1.0


def _failed(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    return [e for e in evaluations if not e.outcome.complete]


def _values(evaluations: Sequence[Evaluation], metric: str) -> Array:
    return np.array(
        [
            evaluation.outcome.metrics[metric]
            for evaluation in evaluations
            if evaluation.outcome.complete
        ]
    )


def _failure(evaluation: Evaluation) -> str:
    context = text.values(evaluation.context) or "none"
    return f"{evaluation.outcome.reason} (context {context}; seed {evaluation.seed})"
