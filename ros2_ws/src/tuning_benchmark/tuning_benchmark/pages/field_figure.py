"""Final surrogates over the plane of two parameters, beside the truth (Fig. 5 of the paper)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bo_tuner.figures.figure import (
    Axis,
    Color,
    ColorScale,
    Contour,
    Dash,
    Element,
    Figure,
    Grid,
    Heatmap,
    Marker,
    Panel,
    Points,
    Region,
    Scale,
)
from bo_tuner.study.study import Study
from tuning_benchmark.experiments.experiment import Case, SurrogateFigure
from tuning_benchmark.pages.summary import Record

LIKELY = 0.5
"""Probability beyond which a region counts as feasible, of outliers, or of crashes."""

PROBABILITY = ColorScale(label="probability of being feasible", low=0.0, high=1.0)


def field_figure(
    case: Case, figure: SurrogateFigure, surrogates: Record, truth: Sequence[Record]
) -> Figure:
    """Surrogates of objective, constraints and probabilities on the left, the truth on the right.

    Parameters
    ----------
    case
        With two tuned parameters.
    figure
        What is shown.
    surrogates
        Result of `fields.surrogate_fields`.
    truth
        Results of `fields.true_fields`, one for each value of the first parameter.
    """
    return Figure(
        name=f"surrogates-{case.name}",
        title=f"Final surrogates and the truth, {case.title}",
        caption=(
            "Left: the surrogates at the end of the run, with the region predicted feasible, "
            "regions of likely outliers or crashes, and the samples; below them the predicted "
            "probability of feasibility, with contours of the probability of an outlier and, where "
            "it is not negligible, of a crash. Right: the truth on the grid, with the truly "
            f"feasible region. Row {figure.row}, seed {figure.seed}."
        ),
        alternative=(
            "Fields over the plane of the two tuned parameters; where they were sampled, "
            "surrogates and truth have the same shape."
        ),
        panels=_panels(case.study, surrogates, truth),
        columns=2,
        panel_height=300,
    )


def _panels(study: Study, surrogates: Record, truth: Sequence[Record]) -> list[Panel]:
    predicted, known = _predicted(study, surrogates), _known(study, truth)
    x, y = surrogates["axes"]
    feasible_truth = _within_limits(study, known)
    marks = _marks(surrogates)
    edge = Contour(x=x, y=y, z=feasible_truth, levels=[LIKELY], name="feasible in truth")

    def panel(title: str, *elements: Element) -> Panel:
        return Panel(x=_axis(study, 0), y=_axis(study, 1), title=title, elements=elements)

    panels = []
    for name, field in predicted.items():
        colors = _colors(study, name, known[name])
        levels = _levels(study, name, colors)
        left, right = (
            (
                Heatmap(x=x, y=y, z=z, colors=colors),
                Contour(x=x, y=y, z=z, levels=levels, color=Color.GRAY, width=0.8, labelled=True),
            )
            for z in (field, known[name])
        )
        panels.append(panel(f"{name}, surrogate", *left, *_regions(x, y, surrogates), *marks))
        panels.append(panel(f"{name}, truth", *right, edge, *marks[-2:]))
    for title, heat, elements in (
        ("predicted probabilities", _grid(surrogates["feasibility"]), _lines(x, y, surrogates)),
        ("feasible in truth", feasible_truth, [edge]),
    ):
        panels.append(
            panel(title, Heatmap(x=x, y=y, z=heat, colors=PROBABILITY), *elements, *marks[-2:])
        )
    return panels


def _predicted(study: Study, result: Record) -> dict[str, Grid]:
    fields = {study.objective.metric: _grid(result["objective"])}
    for name, item in result["constraints"].items():
        fields[name] = _grid(item["field"])
    return fields


def _known(study: Study, columns: Sequence[Record]) -> dict[str, Grid]:
    fields = {study.objective.metric: _grid([c["objective"] for c in columns])}
    for chance in study.drawn_constraints:
        fields[chance.name] = _grid([c["constraints"][chance.name] for c in columns])
    for worst in study.worst_case_constraints:
        fields[worst.name] = _grid([c["worst"] for c in columns])
    return fields


def _grid(columns: Sequence[Sequence[float | None]]) -> Grid:
    """Field (rows, columns) of y and x from its columns; None becomes NaN."""
    return np.array(columns, dtype=np.float64).T


def _within_limits(study: Study, fields: Mapping[str, Grid]) -> Grid:
    within = np.ones_like(fields[study.objective.metric])
    for name, constraint in study.constraints.items():
        field = fields[name]
        within *= np.isfinite(field) & ~constraint.violations(field)
    return within


def _colors(study: Study, name: str, known: Grid) -> ColorScale:
    finite = known[np.isfinite(known)]
    if name == study.objective.metric:
        scale = Scale.LOG if study.objective.scale == "log" else Scale.LINEAR
        # Beyond, a value is only bad: the colours keep the good ones apart.
        low, high = float(finite.min()), float(np.quantile(finite, 0.6))
        unit = study.metrics[name].unit or ""
        return ColorScale(label=name, unit=unit, low=low, high=high, scale=scale)
    constraint = study.constraints[name]
    unit = study.metrics[constraint.metric].unit or ""
    limit = constraint.limit
    spread = float(np.max(np.abs(finite - limit)))
    return ColorScale(
        label=constraint.metric,
        unit=unit,
        low=max(limit - spread, min(0.0, float(finite.min()))),
        high=limit + min(spread, limit),
        middle=limit,
    )


def _levels(study: Study, name: str, colors: ColorScale) -> list[float]:
    """Values along which a field has lines."""
    if name == study.objective.metric:
        space = np.geomspace if colors.scale is Scale.LOG else np.linspace
        return [float(f"{level:.2g}") for level in space(colors.low, colors.high, 7)[1:-1]]
    return [share * study.constraints[name].limit for share in (0.5, 0.75, 1.0, 1.25, 1.5)]


def _lines(x: Sequence[float], y: Sequence[float], result: Record) -> list[Element]:
    """Draw the probabilities of an outlier and of a crash, and the region predicted feasible."""
    return [
        _predicted_edge(x, y, result),
        *(
            Contour(
                x=x, y=y, z=_grid(result[key]), levels=[0.1, 0.5, 0.9], name=name, color=color,
                dash=Dash.DOTTED, labelled=True,
            )
            for key, name, color in (
                ("outlier", "probability of an outlier", Color.ORANGE),
                ("failure", "probability of a crash", Color.VERMILION),
            )
            if np.max(_grid(result[key])) > 0.1
        ),
    ]  # fmt: skip


def _predicted_edge(x: Sequence[float], y: Sequence[float], result: Record) -> Contour:
    z = _grid(result["feasibility"])
    return Contour(x=x, y=y, z=z, levels=[LIKELY], name="predicted feasible", dash=Dash.DASHED)


def _regions(x: Sequence[float], y: Sequence[float], result: Record) -> list[Element]:
    regions: list[Element] = []
    for key, name, color in (
        ("outlier", "outliers likely", Color.ORANGE),
        ("failure", "crashes likely", Color.VERMILION),
    ):
        field = _grid(result[key])
        if (field > LIKELY).any():
            regions.append(Region(x=x, y=y, z=field, above=LIKELY, name=name, color=color))
    regions.append(_predicted_edge(x, y, result))
    return regions


def _marks(result: Record) -> list[Element]:
    """Mark the samples by kind, then the default and the answer."""
    kinds: dict[str, tuple[Marker, Color]] = {
        "sample": (Marker.CIRCLE, Color.INK),
        "outlier": (Marker.DIAMOND, Color.ORANGE),
        "crash": (Marker.CROSS, Color.VERMILION),
    }
    points: dict[str, list[Any]] = {name: [] for name in kinds}
    for sample in result["samples"]:
        kind = "crash" if sample["failed"] else "outlier" if sample["outlier"] else "sample"
        points[kind].append(sample["point"])
    marks: list[Element] = [
        _points(points[name], name, marker, color, 4.0)
        for name, (marker, color) in kinds.items()
        if points[name]
    ]
    marks.append(_points([result["default"]], "default", Marker.SQUARE, Color.PURPLE, 8.0))
    answer = [] if result["answer"] is None else [result["answer"]]
    marks.append(_points(answer, "answer", Marker.STAR, Color.GREEN, 12.0))
    return marks


def _points(
    points: Sequence[Sequence[float]], name: str, marker: Marker, color: Color, size: float
) -> Points:
    x, y = ([p[i] for p in points] for i in (0, 1))
    return Points(x=x, y=y, name=name, marker=marker, color=color, size=size)


def _axis(study: Study, index: int) -> Axis:
    name = study.search_space().names[index]
    parameter = study.parameters[name]
    return Axis(
        label=name,
        unit=parameter.unit or "",
        scale=Scale.LOG if parameter.scale == "log" else Scale.LINEAR,
    )
