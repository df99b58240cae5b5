"""Slices of the surrogates through the tuned parameter set."""

import math
from collections.abc import Sequence

import numpy as np

from bo_tuner.evidence.words.limit_kinds import words_of
from bo_tuner.figures.figure import (
    Axis,
    Band,
    Color,
    Dash,
    Element,
    Figure,
    Limit,
    Line,
    Panel,
    Points,
)
from bo_tuner.models.constraints import LimitedResponse
from bo_tuner.numerics.arrays import Array
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import quantity
from bo_tuner.report.grid import FINE, ParameterGrid, parameter_grid, permitted
from bo_tuner.report.marks import DEFAULT, RESULT
from bo_tuner.report.sections.convergence import describe, predicted_axis
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.metrics import Metric
from bo_tuner.trials import Trial

NEARBY = 0.1
"""A slice shows the trials whose other coordinates in the unit cube are this close."""

MOST_COLUMNS = 4
TWO_SIGMA = 2.0


def slices(analysis: Analysis, answer: Trial) -> Figure:
    """Show how objective and constraints depend on each parameter, with the others fixed."""
    study = analysis.study
    at = analysis.tuned_values(answer.parameters)
    grids = [parameter_grid(study, name, at, FINE) for name in analysis.numbers_of(answer)]
    limited = [
        (study.constraints[name], model) for name, model in analysis.models.constraints.items()
    ]
    panels = []
    for grid in grids:
        panels.append(_objective_slice(analysis, answer, grid))
        panels += [_constraint_slice(analysis, answer, grid, c, model) for c, model in limited]
    columns = min(1 + len(limited), MOST_COLUMNS)
    return Figure(
        name="slices",
        title=f"What would another value do, the others as in the {analysis.answer_set}?",
        caption="Line and band: predicted mean, two standard deviations of it. Dotted: the models "
        "say nothing there." + _of_noise(limited),
        alternative=_ranges(analysis, grids, answer),
        panels=panels,
        columns=columns,
        panel_height=250,
    )


def _objective_slice(analysis: Analysis, answer: Trial, grid: ParameterGrid) -> Panel:
    study, model = analysis.study, analysis.models.objective
    if model is None:
        raise ValueError("no trial is complete")
    points, allowed = _along(analysis, answer, grid)
    mean, variance = model.predict(points)
    sigma = TWO_SIGMA * np.sqrt(variance)
    line, one, other = (
        np.where(allowed, study.from_predicted_cost(cost), math.nan)
        for cost in (mean, mean - sigma, mean + sigma)
    )
    blind = analysis.blind(points)
    # The cost of the compromise cannot be computed from a trial's own evaluations.
    near = _near(analysis, answer, grid) if len(study.objectives) == 1 else []
    y = [math.nan if (m := t.mean(study.objective.metric)) is None else m for t in near]
    return Panel(
        x=grid.axis,
        y=predicted_axis(study),
        elements=[
            *_curve(grid, line, np.minimum(one, other), np.maximum(one, other), blind),
            *_near_points(analysis, near, grid, y),
            *_markers(analysis, answer, grid),
        ],
    )


def _constraint_slice(
    analysis: Analysis,
    answer: Trial,
    grid: ParameterGrid,
    constraint: Constraint,
    model: LimitedResponse,
) -> Panel:
    points, allowed = _along(analysis, answer, grid)
    line, low, high = (
        np.where(allowed, value, math.nan) for value in model.band(points, TWO_SIGMA)
    )
    metric = analysis.study.metrics[constraint.metric]
    return Panel(
        x=grid.axis,
        y=Axis(label=predicted_title(constraint, model, metric), unit=metric.unit),
        elements=[
            *_curve(grid, line, low, high, analysis.blind(points)),
            Limit(value=model.limit, name="limit"),
            *_markers(analysis, answer, grid),
        ],
    )


def _is_of_quantile(constraint: Constraint, model: LimitedResponse) -> bool:
    """Whether a limit with a probability is on a quantile, and not moved by a margin instead."""
    return constraint.rule.on_runs and model.limit == constraint.limit


def predicted_title(constraint: Constraint, model: LimitedResponse, metric: Metric) -> str:
    """Name what the model predicts, which is held against its limit."""
    return words_of(constraint).predicted(metric.title, quantile=_is_of_quantile(constraint, model))


def _of_noise(limited: Sequence[tuple[Constraint, LimitedResponse]]) -> str:
    """Say how the panels allow for the noise of limits with a probability; empty without any."""
    of_single_runs = [pair for pair in limited if pair[0].rule.on_runs]
    if not of_single_runs:
        return ""
    if all(_is_of_quantile(*pair) for pair in of_single_runs):
        return " For a limit with a probability, the quantile of single test runs is drawn."
    return (
        " A limit with a probability is drawn stricter, by a margin for the noise of single "
        "test runs, unless a quantile of these is drawn."
    )


def _curve(
    grid: ParameterGrid, line: Array, low: Array, high: Array, blind: np.ndarray
) -> list[Element]:
    # NaN would break the outline of the band, so it covers the permitted values only.
    kept = np.isfinite(line) & ~blind
    drawn: list[Element] = [
        Band(
            x=grid.values[kept], lower=low[kept], upper=high[kept], name="two sigma",
            color=Color.GRAY,
        ),
        Line(
            x=grid.values, y=np.where(blind, math.nan, line), name="predicted mean",
            color=Color.INK,
        ),
    ]  # fmt: skip
    if np.any(blind & np.isfinite(line)):
        drawn.append(
            Line(
                x=grid.values, y=np.where(blind, line, math.nan), name="not in the models",
                color=Color.GRAY, dash=Dash.DOTTED,
            )
        )  # fmt: skip
    return drawn


def _near_points(
    analysis: Analysis, near: Sequence[Trial], grid: ParameterGrid, y: Sequence[float]
) -> list[Element]:
    if not near:
        return []
    return [
        Points(
            x=[float(trial.parameters[grid.name]) for trial in near], y=y, name="trials nearby",
            color=Color.GRAY, filled=False, hover=[describe(analysis, trial) for trial in near],
            trials=[trial.number for trial in near],
        )
    ]  # fmt: skip


def _markers(analysis: Analysis, answer: Trial, grid: ParameterGrid) -> list[Element]:
    """Return lines at the default and the tuned value."""
    return [
        Limit(
            value=float(analysis.defaults[grid.name]), name="default", vertical=True,
            color=DEFAULT[0], dash=Dash.DASH_DOT,
        ),
        Limit(
            value=float(answer.parameters[grid.name]), name=analysis.answer_name, vertical=True,
            color=RESULT[0], dash=Dash.SOLID,
        ),
    ]  # fmt: skip


def _along(analysis: Analysis, answer: Trial, grid: ParameterGrid) -> tuple[Array, np.ndarray]:
    """Points (n, d) of the slice, and which of them are permitted (n,)."""
    space = analysis.study.search_space()
    points = np.tile(space.to_cube(analysis.tuned_values(answer.parameters)), (len(grid.cube), 1))
    points[:, grid.column] = grid.cube
    return points, permitted(analysis.study, points)


def _near(analysis: Analysis, answer: Trial, grid: ParameterGrid) -> list[Trial]:
    """Return the complete trials close to the slice, without outliers."""
    space = analysis.study.search_space()
    at = space.to_cube(analysis.tuned_values(answer.parameters))
    trials = analysis.comparable
    away = np.abs(space.cube_of(analysis.tuned_values(t.parameters) for t in trials) - at)
    away[:, grid.column] = 0.0
    # Another choice is not near, however many there are.
    away[(away > 0.0) & np.array(space.levels, dtype=bool)] = 1.0
    return [trials[k] for k in np.flatnonzero(away.max(axis=1) <= NEARBY)]


def _ranges(analysis: Analysis, grids: Sequence[ParameterGrid], answer: Trial) -> str:
    study = analysis.study
    axis = predicted_axis(study)
    parts = []
    for grid in grids:
        points, allowed = _along(analysis, answer, grid)
        model = analysis.models.objective
        if model is not None and allowed.any():
            line = study.from_predicted_cost(model.predict_mean(points[allowed]))
            parts.append(
                f"over {grid.axis.label} the {axis.label} ranges from "
                f"{quantity(float(line.min()), axis.unit)} to "
                f"{quantity(float(line.max()), axis.unit)}"
            )
    return f"Along each slice: {'; '.join(parts)}."
