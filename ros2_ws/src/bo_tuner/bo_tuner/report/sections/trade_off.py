"""The trade-off between the objective and the worst case, over all trials."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.evidence.estimates import Estimate
from bo_tuner.evidence.trial_row import OF_VALUE
from bo_tuner.evidence.words.verdict import basis
from bo_tuner.figures.figure import (
    Axis,
    Color,
    Dash,
    Element,
    Figure,
    Limit,
    Line,
    Panel,
    Points,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.pareto import nondominated
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, change, number, numbered, quantity
from bo_tuner.report.marks import DEFAULT
from bo_tuner.report.sections.convergence import mean_axis, trial_points
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.limited import UPPER
from bo_tuner.study.limits import keeps_limits
from bo_tuner.study.titles import mean_title
from bo_tuner.text import capitalized, counted, with_unit
from bo_tuner.trials import Trial

LIMITS = (0.8, 0.9, 1.0, 1.1, 1.25)
"""Other limits to look at, as factors on the study's."""
NONE = -1
"""In place of the index of a trial: none."""
ERRORS = 2.0
"""Standard errors of a difference, up to which it may be noise."""


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
        f"a {'lower' if c.sign > 0.0 else 'higher'} {study.metrics[c.metric].title}"
        for c in constraints
    )
    estimates = [analysis.estimate(trial, study.objective.metric) for trial in trials]
    means = np.array([estimate.value for estimate in estimates])
    leads, figures, tables = [], [], []
    for place, constraint in enumerate(constraints):
        worst = np.array([trial.worst_cases[constraint.name].value for trial in trials])
        front = pareto_front(study.objective.sign * means, constraint.sign * worst)
        leads.append(
            f"The Pareto front has {len(front)} of {counted(len(trials), 'trial')}, "
            "without failed and far-off ones: no other trial has both a better objective and a "
            f"better worst {study.metrics[constraint.metric].title}, within limits or not."
        )
        name = numbered("trade-off", place)
        figures.append(_figure(analysis, constraint, name, trials, means, worst, front))
        moved = _moved_limits(analysis, constraint, trials, estimates)
        if len(moved) > 1:
            tables.append(_table(analysis, constraint, trials, means, moved))
        else:
            leads.append(_nothing_gained(analysis, constraint, moved))
    return Section(
        name="trade-off",
        title=f"What does {names} cost?",
        lead=" ".join(filter(None, leads)),
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
    objective = study.metrics[study.objective.metric]
    return Figure(
        name=name,
        title=f"{capitalized(mean_title(objective.title))} against worst {limited.title}, "
        "all trials",
        caption=f"Means {analysis.means_in_words}; the default by fresh test runs.",
        alternative="; ".join(
            f"trial {trials[k].number}: {number(float(means[k]))} at worst "
            f"{number(float(worst[k]))}"
            for k in front
        ),
        panels=[
            Panel(
                x=Axis(label=f"worst {limited.title}", unit=limited.unit),
                y=mean_axis(study, study.objective),
                elements=[
                    Limit(value=constraint.limit, name="limit", vertical=True),
                    Line(
                        x=worst[front],
                        y=means[front],
                        name="Pareto front",
                        color=Color.INK,
                        dash=Dash.DOTTED,
                        hover=[f"front: trial {trials[k].number}" for k in front],
                        trials=[trials[k].number for k in front],
                    ),
                    *_default(analysis, constraint),
                    *trial_points(analysis, trials, worst, means),
                ],
            )
        ],
    )


def _table(
    analysis: Analysis,
    constraint: Constraint,
    trials: list[Trial],
    means: Array,
    moved: Mapping[int, Sequence[float]],
) -> Table:
    study = analysis.study
    objective, limited = study.metrics[study.objective.metric], study.metrics[constraint.metric]
    own = next((k for k, limits in moved.items() if constraint.limit in limits), None)
    among = ", among trials that keep all others" if len(analysis.study.constraints) > 1 else ""
    return Table(
        caption=f"Best {mean_title(objective.title)}, {analysis.means_in_words}, if "
        f"{limited.title} had another limit{among}",
        header=[
            with_unit("limit", limited.unit),
            "trial",
            mean_title(objective.title),
            "relative to the present limit",
        ],
        rows=[
            [
                _range(limits),
                "none" if k == NONE else str(trials[k].number),
                "–" if k == NONE else quantity(float(means[k]), objective.unit),
                "–"
                if NONE in (k, own) or own is None
                else change(float(means[k]), float(means[own])),
            ]
            for k, limits in moved.items()
        ],
        numeric=[0, 1, 2, 3],
    )


def _range(limits: Sequence[float]) -> str:
    return number(limits[0]) if len(limits) == 1 else f"{number(limits[0])} to {number(limits[-1])}"


def _nothing_gained(
    analysis: Analysis, constraint: Constraint, moved: Mapping[int, Sequence[float]]
) -> str:
    """Say that the limits that were looked at make no difference beyond the noise."""
    ((best, limits),) = moved.items()
    limit = f"a limit of {_range(limits)} {analysis.study.metrics[constraint.metric].unit}".rstrip()
    if best == NONE:
        return f"No trial keeps {limit}."
    if len(limits) == 1:
        return ""
    title = analysis.study.metrics[analysis.study.objective.metric].title
    return f"With {limit} the best {mean_title(title)} is the same, up to noise."


def pareto_front(cost: Array, worst: Array) -> list[int]:
    """Return the indices of points that no other one dominates, by increasing `worst`."""
    front = np.flatnonzero(nondominated(np.column_stack([worst, cost])))
    return sorted(front.tolist(), key=lambda k: float(worst[k]))


def _moved_limits(
    analysis: Analysis, constraint: Constraint, trials: list[Trial], estimates: list[Estimate]
) -> dict[int, list[float]]:
    """Return the limits that lead to the same best trial, by its index; `NONE` if none keeps them.

    A trial is within a limit if its verdict says so. Trials with means that differ by no more than
    their noise are the same. A limit outside the declared range of its metric is none.
    """
    study = analysis.study
    low, high = study.metrics[constraint.metric].range or (-np.inf, np.inf)
    cost = study.objective.sign * np.array([estimate.value for estimate in estimates])
    limits_by_trial: dict[int, list[float]] = {}
    # Those of a limit of 0 are all the same.
    for limit in dict.fromkeys(sorted(factor * constraint.limit for factor in LIMITS)):
        if not low < limit < high:
            continue
        upper = constraint.side == UPPER
        moved = replace(constraint, upper=limit) if upper else replace(constraint, lower=limit)
        other = replace(study, constraints={**study.constraints, constraint.name: moved})
        within = np.flatnonzero([keeps_limits(other, trial) for trial in trials])
        best = int(within[np.argmin(cost[within])]) if len(within) else NONE
        alike = [k for k in limits_by_trial if _alike(estimates, k, best)]
        limits_by_trial.setdefault(alike[0] if alike else best, []).append(limit)
    return limits_by_trial


def _alike(estimates: list[Estimate], one: int, other: int) -> bool:
    """Return whether the means of two trials differ by no more than their errors."""
    if NONE in (one, other):
        return one == other
    a, b = estimates[one], estimates[other]
    return abs(a.value - b.value) <= ERRORS * math.hypot(a.error, b.error) or one == other


def _default(analysis: Analysis, constraint: Constraint) -> list[Element]:
    """Return the default as the verdict has it; nothing before a verdict compares it."""
    study, quantities = analysis.study, analysis.verdict.quantities
    objective = study.objective.metric
    metric = study.metrics[objective]
    means = [q.default for q in quantities if q.metric == objective and q.difference is not None]
    largest = [q for q in quantities if q.constraint == constraint.name]
    if not means or not largest or not np.isfinite([means[0], largest[0].default]).all():
        return []
    return [
        Points(
            x=[largest[0].default],
            y=[means[0]],
            name="default",
            color=DEFAULT[0],
            marker=DEFAULT[1],
            size=10,
            hover=[
                f"default, in {basis(analysis.verdict)}\n"
                f"{mean_title(metric.title)} {quantity(means[0], metric.unit)}\n"
                f"{largest[0].label} {quantity(largest[0].default, largest[0].unit)}"
            ],
        )
    ]
