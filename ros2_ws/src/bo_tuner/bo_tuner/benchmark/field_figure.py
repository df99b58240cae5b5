"""Final surrogates over the plane of two parameters, beside the truth (Fig. 5 of the paper)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bo_tuner.benchmark.experiment import Case
from bo_tuner.benchmark.summary import Record
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
from bo_tuner.study import Study

LIKELY = 0.5
"""Probability beyond which a region counts as feasible, of outliers, or of crashes."""


def field_figure(case: Case, surrogates: Record, truth: Sequence[Record]) -> Figure:
    """Surrogates of objective and constraints above, the truth below.

    Parameters
    ----------
    case
        With two tuned parameters.
    surrogates
        Result of `fields.surrogate_fields`.
    truth
        Results of `fields.true_fields`, one for each value of the first parameter.
    """
    study = case.study
    believed, known = _believed(study, surrogates), _known(study, truth)
    scales = {name: _colors(study, name, known[name]) for name in known}
    x, y = surrogates["axes"]
    feasible_truth = _within_limits(study, known)
    panels = []
    for name, field in believed.items():
        elements: list[Element] = [Heatmap(x=x, y=y, z=field, colors=scales[name])]
        elements += _regions(x, y, surrogates)
        elements += _marks(surrogates)
        panels.append(
            Panel(
                x=_axis(study, 0), y=_axis(study, 1), title=f"{name}, surrogate", elements=elements
            )
        )
    for name, field in known.items():
        elements = [
            Heatmap(x=x, y=y, z=field, colors=scales[name]),
            Contour(x=x, y=y, z=feasible_truth, levels=[LIKELY], name="feasible in truth"),
            *_marks(surrogates)[-2:],
        ]
        panels.append(
            Panel(x=_axis(study, 0), y=_axis(study, 1), title=f"{name}, truth", elements=elements)
        )
    figure = case.surrogates
    run = "" if figure is None else f" Row {figure.row}, seed {figure.seed}."
    return Figure(
        name=f"surrogates-{case.name}",
        title=f"Final surrogates and the truth, {case.title}",
        caption=(
            "Above: what the surrogates believe in the end, with the area believed feasible, "
            "regions of likely outliers or crashes, and the samples. Below: the truth by the "
            f"grid, with the truly feasible area.{run}"
        ),
        alternative=(
            "Fields over the plane of the two tuned parameters; where they were sampled, "
            "surrogates and truth have the same shape."
        ),
        panels=panels,
        columns=len(believed),
        panel_height=300,
    )


def _believed(study: Study, result: Record) -> dict[str, Grid]:
    fields = {study.objective.metric: _grid(result["objective"])}
    for name, item in result["constraints"].items():
        fields[name] = _grid(item["field"])
    return fields


def _known(study: Study, columns: Sequence[Record]) -> dict[str, Grid]:
    fields = {study.objective.metric: _grid([c["objective"] for c in columns])}
    for chance in study.chance_constraints:
        fields[chance.name] = _grid([c["constraints"][chance.name] for c in columns])
    if study.worst_case_constraint is not None:
        fields[study.worst_case_constraint.name] = _grid([c["worst"] for c in columns])
    return fields


def _grid(columns: Sequence[Sequence[float | None]]) -> Grid:
    """Field (rows, columns) of y and x from its columns; None becomes NaN."""
    return np.array(columns, dtype=np.float64).T


def _within_limits(study: Study, fields: Mapping[str, Grid]) -> Grid:
    within = np.ones_like(fields[study.objective.metric])
    for name, constraint in study.constraints.items():
        within *= fields[name] <= constraint.upper
    return within


def _colors(study: Study, name: str, known: Grid) -> ColorScale:
    finite = known[np.isfinite(known)]
    if name == study.objective.metric:
        scale = Scale.LOG if study.objective.scale == "log" else Scale.LINEAR
        low, high = float(finite.min()), float(np.quantile(finite, 0.9))
        unit = study.metrics[name].unit or ""
        return ColorScale(label=name, unit=unit, low=low, high=high, scale=scale)
    constraint = study.constraints[name]
    unit = study.metrics[constraint.metric].unit or ""
    spread = float(np.max(np.abs(finite - constraint.upper)))
    return ColorScale(
        label=constraint.metric,
        unit=unit,
        low=max(constraint.upper - spread, min(0.0, float(finite.min()))),
        high=constraint.upper + min(spread, constraint.upper),
        middle=constraint.upper,
    )


def _regions(x: Sequence[float], y: Sequence[float], result: Record) -> list[Element]:
    found: list[Element] = []
    for key, name, color in (
        ("outlier", "outliers likely", Color.ORANGE),
        ("failure", "crashes likely", Color.VERMILION),
    ):
        field = _grid(result[key])
        if (field > LIKELY).any():
            found.append(Region(x=x, y=y, z=field, above=LIKELY, name=name, color=color))
    feasibility = _grid(result["feasibility"])
    found.append(
        Contour(
            x=x,
            y=y,
            z=feasibility,
            levels=[LIKELY],
            name="believed feasible",
            dash=Dash.DASHED,
        )
    )
    return found


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
