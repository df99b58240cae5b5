"""What the models predict of parameter sets that nobody has tried: one by one, along sliders.

A slider has the values of a parameter. By itself, with the other parameters as in the answer, its
predictions are part of the page; those of several at once need the models, which a server has.
"""

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bo_tuner.figures.figure import Axis
from bo_tuner.models.protocol import Model
from bo_tuner.numerics.arrays import Array
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Forecast, Slider, WhatIf, number
from bo_tuner.report.grid import POINTS, ParameterGrid, parameter_grid, permitted
from bo_tuner.report.sections.convergence import mean_axis, predicted_axis
from bo_tuner.report.sections.slices import TWO_SIGMA, predicted_title
from bo_tuner.storage.run_folder import STUDY
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.text import percent, shown, shown_beside, with_unit

FromCost = Callable[[Array], Array]
"""Returns an objective by its cost, in the unit of its metric."""

LIKELY = "likely within limits"
NOT_PERMITTED = "These values break the order of the parameters or a condition."
BLIND = "Trials near there failed or were far off: the models say nothing there."


def what_if(analysis: Analysis) -> WhatIf | None:
    """Return the sliders around the answer; None while there is nothing to predict."""
    grids = _grids(analysis)
    if not grids:
        return None
    at = _at(analysis)
    along = []
    for grid in grids:
        points = np.tile(at, (len(grid.cube), 1))
        points[:, grid.column] = grid.cube
        along.append(_forecasts(analysis, points))
    parameters = analysis.study.parameters
    sliders = [
        Slider(
            grid.name,
            with_unit(parameters[grid.name].title, parameters[grid.name].unit),
            [float(value) for value in grid.values],
            [number(float(value)) for value in grid.values],
            int(np.abs(grid.cube - at[grid.column]).argmin()),
        )
        for grid in grids
    ]
    return WhatIf(sliders, _rows(analysis), along, command(analysis))


def command(analysis: Analysis) -> str:
    """Return how to run a set once, up to the values of the sliders."""
    record, answer = analysis.record, analysis.answer
    if record.backend == FUNCTION or answer is None:
        return ""
    space = analysis.study.search_space()
    words = ["try", str(record.path.resolve() / STUDY)]
    if record.backend == IN_PROCESS:
        words += ["--backend", IN_PROCESS]
    for name in space.names:
        if name not in space.numbers and name in space.active(answer.parameters):
            words += ["--set", f"{name}={shown(answer.parameters[name])}"]
    return shlex.join(words)


def forecast(analysis: Analysis, values: Mapping[str, float]) -> Forecast | None:
    """Return what is predicted with other values of tuned numbers than the answer has.

    None while there is nothing to predict, or for what is no value of a tuned number.
    """
    answer, space = analysis.answer, analysis.study.search_space()
    if answer is None or analysis.models.objective is None:
        return None
    parameters = analysis.tuned_values(answer.parameters)
    for name, value in values.items():
        if name not in space.numbers:
            return None
        column = space.names.index(name)
        if not space.lower[column] <= value <= space.upper[column]:
            return None
        is_integer = analysis.study.parameters[name].is_integer
        parameters[name] = round(value) if is_integer else value
    return _forecasts(analysis, space.to_cube(parameters)[None])[0]


def _grids(analysis: Analysis) -> list[ParameterGrid]:
    """Return a grid for each tuned number, which has the value of the answer, too."""
    answer = analysis.answer
    if answer is None or analysis.models.objective is None:
        return []
    at = analysis.tuned_values(answer.parameters)
    names = analysis.numbers_of(answer)
    return [_with(analysis, parameter_grid(analysis.study, name, at, POINTS)) for name in names]


def _with(analysis: Analysis, grid: ParameterGrid) -> ParameterGrid:
    answer = analysis.answer
    if answer is None or answer.parameters[grid.name] in grid.values:
        return grid
    place = int(np.searchsorted(grid.cube, _at(analysis)[grid.column]))
    return replace(
        grid,
        values=np.insert(grid.values, place, float(answer.parameters[grid.name])),
        cube=np.insert(grid.cube, place, _at(analysis)[grid.column]),
    )


def _at(analysis: Analysis) -> Array:
    """Return the point (d,) of the answer in the unit cube."""
    answer = analysis.answer
    if answer is None:
        raise ValueError("there is no answer")
    return analysis.study.search_space().to_cube(analysis.tuned_values(answer.parameters))


def _rows(analysis: Analysis) -> list[tuple[str, str]]:
    study = analysis.study
    rows = [(axis.title, "") for axis, *_ in _objectives(analysis)]
    for name, model in analysis.models.constraints.items():
        constraint = study.constraints[name]
        metric = study.metrics[constraint.metric]
        title = predicted_title(constraint, model, metric)
        rows.append((with_unit(title, metric.unit), number(model.limit)))
    return [*rows, (LIKELY, "")] if analysis.models.constraints else rows


def _forecasts(analysis: Analysis, points: Array) -> list[Forecast]:
    """Return what is predicted at points (n, d) of the unit cube."""
    study, models = analysis.study, analysis.models
    columns = [
        _in_words(_band(model, from_cost, points)) for _, model, from_cost in _objectives(analysis)
    ]
    columns += [
        _in_words(model.band(points, TWO_SIGMA), model.limit)
        for model in models.constraints.values()
    ]
    if models.constraints:
        columns.append([percent(float(value)) for value in models.feasibility(points)])
    allowed, blind = permitted(study, points), analysis.blind(points)
    remarks = [
        BLIND if is_blind else "" if is_permitted else NOT_PERMITTED
        for is_permitted, is_blind in zip(allowed, blind, strict=True)
    ]
    return [Forecast(list(cells), remark) for *cells, remark in zip(*columns, remarks, strict=True)]


def _objectives(analysis: Analysis) -> list[tuple[Axis, Model, FromCost]]:
    """Return of each objective its axis, the model of its cost, and how it follows from that.

    With several of them and no model of each, that is the one that trials are proposed by.
    """
    study, models = analysis.study, analysis.models
    if models.costs.keys() >= {item.metric for item in study.objectives}:
        return [
            (mean_axis(study, item), models.costs[item.metric], item.from_cost)
            for item in study.objectives
        ]
    if models.objective is None:
        raise ValueError("no trial is complete")
    return [(predicted_axis(study), models.objective, study.from_predicted_cost)]


def _band(model: Model, from_cost: FromCost, points: Array) -> tuple[Array, Array, Array]:
    """Return the mean of an objective and the ends of its band, (n,) each."""
    mean, variance = model.predict(points)
    half = TWO_SIGMA * np.sqrt(variance)
    one, other = from_cost(mean - half), from_cost(mean + half)
    return from_cost(mean), np.minimum(one, other), np.maximum(one, other)


def _in_words(bands: tuple[Array, Array, Array], limit: float = math.nan) -> list[str]:
    """Format means and the ends of their bands, (n,) each, so that the side of a limit is seen."""
    return [
        f"{number(mean) if math.isnan(limit) else shown_beside(mean, limit)} "
        f"({number(low)} to {number(high)})"
        for mean, low, high in zip(*(band.tolist() for band in bands), strict=True)
    ]
