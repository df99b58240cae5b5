"""The numbers of a verdict, from evaluations of the default and of the tuned parameter set."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan

import numpy as np

from bo_tuner.evidence.context_covariates import covariates
from bo_tuner.evidence.differences import Change, Difference, paired, unpaired
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantity import DrawsOf, OnRecord, Quantity, ViolationBound
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.study.titles import mean_title


def quantities(
    study: Study,
    default: Observed,
    tuned: Observed,
    default_limits: Mapping[str, LimitVerdict],
    tuned_limits: Mapping[str, LimitVerdict],
    violations: Mapping[str, ViolationBound],
) -> tuple[Quantity, ...]:
    """Return the numbers of a verdict: of each constraint, and the mean of each other metric."""
    all_quantities = [
        replace(
            _of_constraint(study, constraint, default, tuned),
            violation=violations.get(name),
            default_limit_verdict=default_limits.get(name),
            limit_verdict=tuned_limits[name],
        )
        for name, constraint in study.constraints.items()
    ]
    objectives = {objective.metric for objective in study.objectives}
    # The worst case of an objective says nothing of its mean.
    compared = {q.metric for q in all_quantities if q.difference is not None} - objectives
    # The default is compared in its own draws, where the tuned parameter set has these.
    beside = tuned if tuned.beside is None else tuned.beside
    space = study.context_space()
    signs = {constraint.metric: constraint.sign for constraint in study.constraints.values()}
    both = {
        constraint.metric
        for constraint in study.constraints.values()
        if constraint.sign != signs[constraint.metric]
    }
    for name, metric in study.metrics.items():
        if name in compared:
            continue
        # Between two limits neither direction is the better one.
        sign = 0.0 if name in both else signs.get(name, 0.0)
        for objective in study.objectives:
            if name == objective.metric:
                sign = objective.sign
        both_sides, of_draws = _pairs(study, default, beside, name)
        difference = paired(*both_sides, of_draws)
        estimates = default.estimate(name, space), beside.estimate(name, space)
        all_quantities.append(
            Quantity(
                label=mean_title(metric.title),
                metric=name,
                title=metric.title,
                unit=metric.unit,
                default=estimates[0].value,
                tuned=estimates[1].value,
                estimates=estimates,
                difference=difference,
                change=difference.change(sign),
                draws=_draws(default, tuned, name, difference),
                objective=name in objectives,
            )
        )
    return _ordered(all_quantities, study.objective.metric)


def _of_constraint(
    study: Study,
    constraint: Constraint,
    default: Observed,
    tuned: Observed,
) -> Quantity:
    """Return the worst case if that of the tuned parameter set was searched, or else the extreme.

    The extreme value is that in the draws.
    """
    metric, name = constraint.metric, constraint.name
    title = study.metrics[metric].title
    label = f"{constraint.extreme} {title}"
    values = tuple(constraint.farthest(side.values(metric)) for side in (default, tuned))
    difference: Difference | None = None
    change, bound = Change.UNKNOWN, nan
    draws, default_unsearched = _draws(default, tuned, metric, None), False
    if name in tuned.worst:
        theirs, ours = default.worst.get(name), tuned.worst[name]
        label = f"worst-case {study.limited(constraint)}"
        values = nan if theirs is None else theirs.value, ours.value
        draws = None
        if not constraint.rule.on_runs:
            bound = ours.bound
        if theirs is None:
            default_unsearched = True
        else:
            difference = unpaired(
                (theirs.value, theirs.standard_error, theirs.count),
                (ours.value, ours.standard_error, ours.count),
            )
            change = difference.change(constraint.sign)
    known = tuned.on_record(metric)
    return Quantity(
        label=study.titled(constraint, label),
        metric=metric,
        title=title,
        unit=study.metrics[metric].unit,
        default=values[0],
        tuned=values[1],
        difference=difference,
        change=change,
        limit=constraint.limit,
        bound=bound,
        on_record=OnRecord(len(known), constraint.farthest(known)) if known else None,
        default_unsearched=default_unsearched,
        draws=draws,
        constraint=name,
    )


def _draws(
    default: Observed, tuned: Observed, metric: str, difference: Difference | None
) -> DrawsOf | None:
    """Tell how many draws each number is from, unless all are from the same number of draws."""
    m, n = (sum(metric in metrics for metrics in side.drawn.values()) for side in (default, tuned))
    if difference is not None and difference.count:
        return None if difference.count == m == n else DrawsOf(m, n, difference.count)
    return None if m == n else DrawsOf(m, n)


def _pairs(
    study: Study, default: Observed, tuned: Observed, metric: str
) -> tuple[tuple[Array, Array], Array]:
    """Return a metric in the draws that both parameter sets completed, and covariates of these.

    The metric is of shape (n,) for either, the covariates (n, p). There are none if draws failed:
    the contexts of the others are no sample of their distribution.
    """
    common = default.drawn.keys() & tuned.drawn.keys() if default.source is tuned.source else ()
    draws = [k for k in sorted(common) if metric in default.drawn[k] and metric in tuned.drawn[k]]
    sides = tuple(np.array([side.drawn[k][metric] for k in draws]) for side in (default, tuned))
    if len(draws) < default.draws or not all(k in default.contexts for k in draws):
        return (sides[0], sides[1]), np.empty((len(draws), 0))
    contexts = [default.contexts[k] for k in draws]
    return (sides[0], sides[1]), covariates(study.context_space(), contexts)


def _ordered(quantities: Sequence[Quantity], objective: str) -> tuple[Quantity, ...]:
    """Order quantities: the objectives, the first one of the study first; limits; the others."""

    def rank(quantity: Quantity) -> int:
        if quantity.objective:
            return 0 if quantity.metric == objective else 1
        return 2 if quantity.constraint else 3

    return tuple(sorted(quantities, key=rank))
