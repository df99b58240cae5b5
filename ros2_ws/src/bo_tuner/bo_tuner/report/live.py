"""The panels of the page of a run in progress: what trials say by themselves, without models."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.evidence.trial_row import TrialOutcome, outcome_of, trial_row
from bo_tuner.evidence.words.trials import outcome, sign
from bo_tuner.figures.figure import Axis, Element, Limit, Line, Panel, Points, Scale
from bo_tuner.numerics.arrays import Array
from bo_tuner.report.content import Table
from bo_tuner.report.marks import OFF_SCALE, RESULT
from bo_tuner.report.sections.convergence import (
    beyond,
    mean_axis,
    on_scale,
    points_by_outcome,
    scale_end,
)
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.text import counted, shown, shown_beside, with_unit
from bo_tuner.trials import Trial, TrialState
from bo_tuner.tuning.question import Change, Expected

LATEST = 8
"""Trials in the table."""
PERCENT = "% of the limit"
MARGIN = 0.08
"""Of a bar beyond what it shows, as a share of that."""


def in_percent(constraint: Constraint) -> bool:
    """Return whether values are told in percent of a limit: of none below 0, or at it."""
    return constraint.limit > 0.0


def of_limit(constraint: Constraint, value: float) -> float:
    """Return a value in percent of a limit, if it has any: else in the metric's unit."""
    return 100.0 * value / constraint.limit if in_percent(constraint) else value


def objective_panel(study: Study, trials: Sequence[Trial], best: Mapping[int, int | None]) -> Panel:
    """Return the objective by trial, and the best within limits so far, from the first one on."""
    objective = study.objective
    axis, sign = mean_axis(study, objective), objective.sign
    outcomes = [outcome_of(study, trial) for trial in trials]
    values = np.array([_mean(trial, objective.metric) for trial in trials])
    places = _places(trials)
    elements: list[Element] = []
    if any(number is not None for number in best.values()):
        counts = sorted(best)
        numbers = [best[count] for count in (*counts, counts[-1])]
        elements.append(
            Line(
                x=[*(count - 1.0 for count in counts), len(trials) - 0.5],
                y=[math.nan if number is None else values[number] for number in numbers],
                name="best within limits, by the models",
                color=RESULT[0],
                step=True,
            )
        )
    elements += _points(outcomes, places, values, axis.scale, sign, [])
    return Panel(x=_trials(trials), y=axis, elements=elements)


def limit_panels(study: Study, trials: Sequence[Trial]) -> list[Panel]:
    """Return a strip for each limit, in percent of it, with a line at 100 %."""
    rows = [trial_row(study, trial) for trial in trials]
    outcomes = [row.outcome for row in rows]
    places = _places(trials)
    panels = []
    for place, constraint in enumerate(study.constraints.values()):
        metric = study.metrics[constraint.metric]
        unit = "%" if in_percent(constraint) else metric.unit
        values = np.array(
            [of_limit(constraint, row.limits[place].value) for row in rows], dtype=float
        )
        line = of_limit(constraint, constraint.limit)
        title = with_unit(study.limit_title(constraint), unit)
        side = "≤" if constraint.sign > 0.0 else "≥"
        limit = f"{constraint.limit:g} {metric.unit}".rstrip()
        panels.append(
            Panel(
                title=f"{title}, limit {side} {limit}",
                x=_trials(trials, ""),
                y=Axis(label=""),
                elements=[
                    Limit(value=line),
                    *_points(outcomes, places, values, Scale.LINEAR, constraint.sign, [line]),
                ],
            )
        )
    return panels


def latest_trials(study: Study, trials: Sequence[Trial]) -> Table:
    """Return the latest trials, the last one at the top."""
    tuned = [item for item in study.parameters.values() if item.is_tuned]
    limits = list(study.constraints.values())
    header = ["trial", *(with_unit(item.title, item.unit) for item in tuned)]
    for objective in study.objectives:
        metric = study.metrics[objective.metric]
        header.append(with_unit(metric.title, metric.unit))
    for limit in limits:
        unit = PERCENT if in_percent(limit) else study.metrics[limit.metric].unit
        header.append(f"{study.limit_title(limit)}, {unit}".removesuffix(", "))
    rows = []
    for trial in list(trials)[: -LATEST - 1 : -1]:
        row = trial_row(study, trial)
        against = [of_limit(limit.constraint, limit.value) for limit in row.limits]
        why = f": {row.reason}" if row.reason else ""
        rows.append(
            [
                str(row.number),
                *(shown(value) for value in row.parameters),
                *(_shown(mean) for mean in row.objectives),
                *(_shown(value, 3) for value in against),
                str(row.runs),
                f"{sign(row.outcome)} {outcome(row)}{why}",
            ]
        )
    header += ["test runs", "outcome"]
    return Table(
        caption=counted(len(trials), "trial"),
        header=header,
        rows=rows,
        numeric=range(1, len(header) - 1),
    )


def best_values(study: Study, trial: Trial) -> Table:
    """Return the tuned parameters of the best trial, beside the default."""
    best, default = map(study.on_screen, (trial.parameters, study.search_space().defaults))
    return Table(
        caption=f"Values of trial {trial.number}, the best within limits",
        header=["parameter", "value", "default"],
        rows=[
            [
                with_unit(item.title, item.unit),
                shown(best[item.name]),
                shown(default[item.name]),
            ]
            for item in study.parameters.values()
            if item.is_tuned
        ],
        numeric=[1, 2],
    )


@dataclass(frozen=True)
class Bar:
    """A prediction as a row with a bar; places are in percent of the bar's length.

    Attributes
    ----------
    title, expected, band, limit_in_words
        What is predicted, its value, the ends of its band, and the limit.
    low, value, high
        Where these are.
    limit
        Where the limit is; None without one.
    is_over
        Whether the value is beyond it.
    words
        The bar for who does not see it.
    """

    title: str
    expected: str
    band: str
    limit_in_words: str = ""
    low: float = 0.0
    value: float = 0.0
    high: float = 0.0
    limit: float | None = None
    is_over: bool = False
    words: str = ""


def bar(expected: Expected) -> Bar:
    """Return a prediction as a row; a bar begins at 0 where a limit is above that."""
    limit = expected.limit
    numbers = [expected.value, expected.low, expected.high]
    value, low, high = (shown(n) if limit is None else shown_beside(n, limit) for n in numbers)
    row = Bar(with_unit(expected.what, expected.unit), value, f"{low} to {high}")
    if limit is None:
        return row
    seen = [expected.low, expected.high, limit]
    begin = min(0.0, *seen) if limit > 0.0 else min(seen)
    length = (max(seen) - begin) * (1.0 + MARGIN) or 1.0
    places = [round(100.0 * (each - begin) / length, 1) for each in (*numbers, limit)]
    over = (expected.value > limit) if expected.is_upper else (expected.value < limit)
    return replace(
        row,
        limit_in_words=f"{'≤' if expected.is_upper else '≥'} {shown(limit)}",
        value=places[0],
        low=places[1],
        high=places[2],
        limit=places[3],
        is_over=over,
        words=f"{expected.words}, {'beyond' if over else 'within'} its limit",
    )


def step_in_words(change: Change) -> str:
    """Return how a parameter differs from what it is now."""
    now, then = change.now, change.then
    if now == then:
        return "same"
    if isinstance(now, bool | str) or isinstance(then, bool | str):
        return "other"
    return f"{then - now:+.3g}"


def _mean(trial: Trial, metric: str) -> float:
    mean = trial.mean(metric) if trial.state is TrialState.COMPLETE else None
    return math.nan if mean is None else mean


def _shown(value: float, digits: int = 4) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


def _places(trials: Sequence[Trial]) -> Array:
    return np.array([trial.number for trial in trials], dtype=float)


def _trials(trials: Sequence[Trial], label: str = "trial") -> Axis:
    return Axis(label=label, limits=(-0.5, max(len(trials), 8) - 0.5))


def _within(outcomes: Sequence[TrialOutcome]) -> list[bool]:
    return [outcome is TrialOutcome.WITHIN for outcome in outcomes]


def _points(
    outcomes: Sequence[TrialOutcome],
    places: Array,
    values: Array,
    scale: Scale,
    sign: float,
    lines: Sequence[float],
) -> list[Element]:
    """Return a mark for each trial by its outcome; at the edge what has no value, or is beyond."""
    if not len(values):
        return []
    end = scale_end(_within(outcomes), values, scale, sign, lines)
    far = beyond(values, end, sign)
    near = np.flatnonzero(~far)
    drawn = points_by_outcome(
        [outcomes[int(k)] for k in near], places[near], on_scale(values, end, sign)[near]
    )
    if far.any():
        drawn.append(
            Points(
                x=places[far],
                y=np.full(far.sum(), end),
                name="off the scale",
                color=OFF_SCALE[0],
                marker=OFF_SCALE[1],
                size=8.0,
            )
        )
    return drawn
