"""The trade-off between the objective and the worst case, over all trials."""

from dataclasses import replace

import numpy as np

from bo_tuner.figures.figure import (
    Axis,
    Color,
    Dash,
    Element,
    Figure,
    Limit,
    Line,
    Marker,
    Panel,
    Points,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.pareto import nondominated
from bo_tuner.report.analysis import OF_VALUE, Analysis
from bo_tuner.report.content import Section, Table, change, number, numbered, quantity
from bo_tuner.report.sections.convergence import mean_axis, trial_points
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.limited import UPPER
from bo_tuner.study.limits import WITHIN, outcome_in_words
from bo_tuner.text import with_unit
from bo_tuner.trials import Trial

LIMITS = (0.8, 0.9, 1.0, 1.1, 1.25)
"""Other limits to look at, as factors on the study's."""


def trade_off(analysis: Analysis) -> Section | None:
    """Show what a lower worst case costs; None without a worst case or complete trials.

    With several objectives the front of these takes its place.
    """
    study = analysis.study
    if len(study.objectives) > 1:
        return None
    trials = [trial for trial in analysis.trials if analysis.outcome(trial) in OF_VALUE]
    constraints = study.worst_case_constraints
    if not constraints or not trials:
        return None
    names = " and ".join(
        f"a {'lower' if c.sign > 0.0 else 'higher'} {c.metric}" for c in constraints
    )
    means = np.array([analysis.mean_objective(trial) for trial in trials])
    leads, figures, tables = [], [], []
    for place, constraint in enumerate(constraints):
        worst = np.array([trial.worst_cases[constraint.name].value for trial in trials])
        front = pareto_front(study.objective.sign * means, constraint.sign * worst)
        leads.append(
            f"{len(front)} of {len(trials)} trials, without failed and outlying ones, are on the "
            "observed Pareto front: no other trial has both a better objective and a "
            f"better worst {constraint.metric}, whether or not it keeps the limits."
        )
        name = numbered("trade-off", place)
        figures.append(_figure(analysis, constraint, name, trials, means, worst, front))
        tables.append(_table(analysis, constraint, trials, means))
    return Section(
        name="trade-off",
        title=f"What {names} costs",
        lead=" ".join(leads),
        figures=figures,
        tables=tables,
    )


def _figure(
    analysis: Analysis,
    constraint: Constraint,
    name: str,
    trials: list[Trial],
    means: Array,
    worst: Array,
    front: list[int],
) -> Figure:
    study = analysis.study
    limited = study.metrics[constraint.metric]
    return Figure(
        name=name,
        title=f"Mean {study.objective.metric} against worst {limited.name}, all trials",
        caption="Estimates of the trials themselves, with the noise of a few evaluations "
        "each; the best values are biased by selection. The default has the values of the "
        "result section.",
        alternative="; ".join(
            f"trial {trials[k].number}: {number(float(means[k]))} at worst "
            f"{number(float(worst[k]))}"
            for k in front
        ),
        panels=[
            Panel(
                x=Axis(label=f"worst {limited.name}", unit=limited.unit),
                y=mean_axis(study, study.objective),
                elements=[
                    Limit(value=constraint.limit, name="limit", vertical=True),
                    Line(
                        x=worst[front],
                        y=means[front],
                        name="observed Pareto front",
                        color=Color.INK,
                        dash=Dash.DOTTED,
                        hover=[f"front: trial {trials[k].number}" for k in front],
                    ),
                    *_default(analysis, constraint),
                    *trial_points(analysis, trials, worst, means),
                ],
            )
        ],
    )


def _table(analysis: Analysis, constraint: Constraint, trials: list[Trial], means: Array) -> Table:
    objective = analysis.study.objective.metric
    unit = analysis.study.metrics[constraint.metric].unit
    among = ", among trials that keep all others" if len(analysis.study.constraints) > 1 else ""
    return Table(
        caption=f"Best mean {objective} observed if {constraint.metric} had another limit{among}",
        header=[
            with_unit("limit", unit),
            "trial",
            f"mean {objective}",
            "relative to the present limit",
        ],
        rows=_other_limits(analysis, constraint, trials, means),
        numeric=[0, 1, 2, 3],
    )


def pareto_front(cost: Array, worst: Array) -> list[int]:
    """Return the indices of points that no other one dominates, by increasing `worst`.

    Parameters
    ----------
    cost, worst
        Both (n,); smaller is better.
    """
    front = np.flatnonzero(nondominated(np.column_stack([worst, cost])))
    return sorted(front.tolist(), key=lambda k: float(worst[k]))


def _other_limits(
    analysis: Analysis, constraint: Constraint, trials: list[Trial], means: Array
) -> list[list[str]]:
    """Return the best trial within each of several limits, as the verdicts of trials have it."""
    study = analysis.study
    unit = study.metrics[study.objective.metric].unit
    cost = study.objective.sign * means
    # Those of a limit of 0 are all the same.
    limits = dict.fromkeys(factor * constraint.limit for factor in LIMITS)
    best: dict[float, int] = {}
    for limit in limits:
        upper = constraint.side == UPPER
        moved = replace(constraint, upper=limit) if upper else replace(constraint, lower=limit)
        other = replace(study, constraints={**study.constraints, constraint.name: moved})
        within = np.flatnonzero([outcome_in_words(other, trial) == WITHIN for trial in trials])
        if len(within):
            best[limit] = int(within[np.argmin(cost[within])])
    own = best.get(constraint.limit)
    return [
        [
            number(limit),
            str(trials[best[limit]].number) if limit in best else "none",
            quantity(float(means[best[limit]]), unit) if limit in best else "–",
            change(float(means[best[limit]]), float(means[own]))
            if limit in best and own is not None
            else "–",
        ]
        for limit in limits
    ]


def _default(analysis: Analysis, constraint: Constraint) -> list[Element]:
    """Return the default as the verdict has it; nothing before a verdict compares it."""
    study, found = analysis.study, analysis.verdict.quantities
    objective = study.objective.metric
    means = [q.default for q in found if q.metric == objective and q.difference is not None]
    largest = [q for q in found if q.constraint == constraint.name]
    if not means or not largest or not np.isfinite([means[0], largest[0].default]).all():
        return []
    return [
        Points(
            x=[largest[0].default],
            y=[means[0]],
            name="default",
            color=Color.INK,
            marker=Marker.SQUARE,
            size=10,
            hover=[
                f"default, in {analysis.verdict.evidence}\n"
                f"mean {objective} {quantity(means[0], study.metrics[objective].unit)}\n"
                f"{largest[0].label} {quantity(largest[0].default, largest[0].unit)}"
            ],
        )
    ]
