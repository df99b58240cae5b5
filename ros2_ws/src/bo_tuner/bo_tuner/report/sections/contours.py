"""Contours of the objective's surrogate over pairs of parameters, with the feasible region."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from bo_tuner.figures.figure import (
    Color,
    ColorScale,
    Contour,
    Element,
    Figure,
    Heatmap,
    Panel,
    Points,
    Region,
    Scale,
)
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.numerics.arrays import Array
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.grid import POINTS, ParameterGrid, parameter_grid, permitted
from bo_tuner.report.marks import DEFAULT, RESULT
from bo_tuner.report.sections.convergence import outcome_points, predicted_axis
from bo_tuner.trials import Trial

MOST_PARAMETERS = 4
"""Pairs of the parameters with the shortest length scales are drawn, up to this number."""


def contours(analysis: Analysis, answer: Trial) -> Figure:
    """Show the objective and the feasible region over pairs of parameters."""
    study = analysis.study
    at = analysis.tuned_values(answer.parameters)
    names = most_sensitive(analysis)
    grids = {name: parameter_grid(study, name, at, POINTS) for name in names}
    pairs = list(itertools.combinations(names, 2))
    fields = [_field(analysis, answer, grids[a], grids[b]) for a, b in pairs]
    colors = _color_scale(analysis, [cost for cost, _, _ in fields])
    panels = [
        _contour_panel(analysis, answer, (grids[a], grids[b]), field, colors)
        for (a, b), field in zip(pairs, fields, strict=True)
    ]
    label = predicted_axis(study).label
    return Figure(
        name="contours",
        title=f"Where is the {label} best, and what stays within limits?",
        caption="Colour: predicted mean. Hatched: less than 50 % likely within limits. Gray: the "
        "models say nothing there.",
        alternative=_feasible_shares(pairs, fields, analysis),
        panels=panels,
        columns=min(len(panels), 2 if len(panels) in (2, 4) else 3) if len(panels) > 1 else 1,
        panel_height=340 if len(panels) > 1 else 460,
    )


Field = tuple[Array, Array, Array]
"""Objective, probability of feasibility, and 1 where the models say nothing (rows, columns).

The objective is NaN where the models say nothing.
"""


def _field(analysis: Analysis, answer: Trial, a: ParameterGrid, b: ParameterGrid) -> Field:
    study, models = analysis.study, analysis.models
    if models.objective is None:
        raise ValueError("no trial is complete")
    at = study.search_space().to_cube(analysis.tuned_values(answer.parameters))
    points = np.tile(at, (len(a.cube) * len(b.cube), 1))
    points[:, a.column] = np.tile(a.cube, len(b.cube))
    points[:, b.column] = np.repeat(b.cube, len(a.cube))
    shape = len(b.cube), len(a.cube)
    allowed = permitted(study, points)
    objective = study.from_predicted_cost(models.objective.predict_mean(points))
    feasible = models.feasibility(points)
    blind = analysis.blind(points)
    objective, feasible, blank = (
        np.where(allowed, values, math.nan).reshape(shape)
        for values in (np.where(blind, math.nan, objective), feasible, blind.astype(float))
    )
    return objective, feasible, blank


def _contour_panel(
    analysis: Analysis,
    answer: Trial,
    grids: tuple[ParameterGrid, ParameterGrid],
    field: Field,
    colors: ColorScale,
) -> Panel:
    a, b = grids
    objective, feasible, blank = field
    x, y = a.values, b.values
    # Points that are not permitted are shaded as well; gaps would make the edge ragged.
    infeasible = np.where(np.isnan(feasible), 1.0, 1.0 - feasible)
    elements: list[Element] = []
    if np.nanmax(blank, initial=0.0) > 0.0:
        elements.append(
            Region(
                x=x, y=y, z=blank, above=0.5, name="not in the models", color=Color.GRAY,
                hatched=False,
            )
        )  # fmt: skip
    elements.append(Heatmap(x=x, y=y, z=objective, colors=colors))
    if analysis.models.constraints:
        elements.append(
            Region(
                x=x, y=y, z=infeasible, above=1.0 - BELIEVED_FEASIBLE,
                name="not likely within limits",
            )
        )  # fmt: skip
        elements.append(
            Contour(
                x=x, y=y, z=feasible, levels=[BELIEVED_FEASIBLE], name="50 % likely within limits",
                color=Color.INK, width=2.0,
            )
        )  # fmt: skip
    of_a, of_b = (np.array([float(t.parameters[g.name]) for t in analysis.trials]) for g in grids)
    elements += outcome_points(analysis, analysis.trials, of_a, of_b, size=5)
    for name, parameters, (color, marker) in (
        ("default", analysis.defaults, DEFAULT),
        (analysis.answer_name, answer.parameters, RESULT),
    ):
        elements.append(
            Points(
                x=[float(parameters[a.name])], y=[float(parameters[b.name])], name=name,
                color=color, marker=marker, size=13, hover=[name],
            )
        )  # fmt: skip
    return Panel(x=a.axis, y=b.axis, elements=elements)


def _color_scale(analysis: Analysis, fields: Sequence[Array]) -> ColorScale:
    """Return a scale over the best 90 % of all values; worse ones have the last colour."""
    study = analysis.study
    axis = predicted_axis(study)
    seen = np.concatenate([field[np.isfinite(field)] for field in fields])
    is_maximized = len(study.objectives) == 1 and study.objective.sign < 0
    shares = [0.1, 1.0] if is_maximized else [0.0, 0.9]
    low, high = np.quantile(seen, shares) if len(seen) else (0.0, 1.0)
    if not low < high:
        low, high = low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)
    scale = axis.scale if low > 0.0 else Scale.LINEAR
    return ColorScale(
        label=axis.label, unit=axis.unit, low=float(low), high=float(high), scale=scale
    )


def most_sensitive(analysis: Analysis) -> list[str]:
    """Return the parameters with the shortest length scales, in the study's order."""
    space, model = analysis.study.search_space(), analysis.models.objective
    if model is None:
        return list(space.numbers[:MOST_PARAMETERS])
    order = np.argsort(model.length_scales, kind="stable")
    order = np.array([k for k in order if space.names[k] in space.numbers])[:MOST_PARAMETERS]
    return [space.names[k] for k in sorted(order)]


def _feasible_shares(
    pairs: Sequence[tuple[str, str]], fields: Sequence[Field], analysis: Analysis
) -> str:
    items = analysis.study.parameters
    titles = [f"{items[a].title} and {items[b].title}" for a, b in pairs]
    if not analysis.models.constraints:
        return f"Predicted mean over {', '.join(titles)}."
    shares = [
        100.0 * float(np.mean(feasible[np.isfinite(feasible)] >= BELIEVED_FEASIBLE))
        for _, feasible, _ in fields
    ]
    texts = [f"{title}: {s:.0f} %" for title, s in zip(titles, shares, strict=True)]
    return f"Share of the area likely within limits: {'; '.join(texts)}."
