"""What explains a figure beside its panels: the legend, and the bars of its colour scales."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.figures.figure import (
    Color,
    ColorScale,
    Contour,
    Dash,
    Figure,
    Heatmap,
    Limit,
    Line,
    Points,
    Scale,
)
from bo_tuner.figures.palette import DIVERGING, SEQUENTIAL

STOPS = 33
"""Colours of a scale whose steps are not even."""


@dataclass(frozen=True)
class LegendEntry:
    """What a page shows for all elements of a name: ``kind`` is line, area or a marker's name."""

    name: str
    kind: str
    color: Color
    dash: Dash = Dash.SOLID
    filled: bool = True


@dataclass(frozen=True)
class ColorBar:
    """A bar of colours: its title, its colours from low to high, and texts at some places.

    The places of ``stops`` and ``ticks`` are between 0 and 1.
    """

    title: str
    stops: Sequence[tuple[float, str]]
    ticks: Sequence[tuple[float, str]]


def legend(figure: Figure) -> list[LegendEntry]:
    """List the names in a figure, in the order of their first element."""
    entries: dict[str, LegendEntry] = {}
    for element in (e for panel in figure.panels for e in panel.elements):
        name = getattr(element, "name", "")
        if not name or name in entries or isinstance(element, Heatmap):
            continue
        match element:
            case Line() | Contour() | Limit():
                entry = LegendEntry(name, "line", element.color, element.dash)
            case Points():
                color = element.color if element.values is None else Color.INK
                entry = LegendEntry(name, element.marker, color, filled=element.filled)
            case _:
                entry = LegendEntry(name, "area", element.color)
        # Beside the field there is the ground of the page.
        on_page = Color.INK if entry.color is Color.BLACK else entry.color
        entries[name] = replace(entry, color=on_page)
    return list(entries.values())


def color_bars(figure: Figure) -> list[ColorBar]:
    """List the colour scales in a figure as bars."""
    scales = dict.fromkeys(
        scale
        for panel in figure.panels
        for element in panel.elements
        if (scale := getattr(element, "colors", None)) is not None
    )
    return [_bar(scale) for scale in scales]


def place(scale: ColorScale, value: float) -> float:
    """Where a value is on the bar of a scale, between 0 and 1."""
    if scale.middle is not None:
        if value < scale.middle:
            return 0.5 * (value - scale.low) / (scale.middle - scale.low)
        return 0.5 + 0.5 * (value - scale.middle) / (scale.high - scale.middle)
    if scale.scale is Scale.LOG:
        return math.log(value / scale.low) / math.log(scale.high / scale.low)
    return (value - scale.low) / (scale.high - scale.low)


def stops(scale: ColorScale) -> list[tuple[float, str]]:
    """Colours at places that are even in the value, as Plotly wants them."""
    if scale.middle is None and scale.scale is Scale.LINEAR:
        return list(SEQUENTIAL)
    even = np.linspace(scale.low, scale.high, STOPS)
    return [
        (round(k / (STOPS - 1), 6), _color(scale, place(scale, float(value))))
        for k, value in enumerate(even)
    ]


def _color(scale: ColorScale, at: float) -> str:
    colors = SEQUENTIAL if scale.middle is None else DIVERGING
    places = [p for p, _ in colors]
    channels = [
        np.interp(at, places, [int(c[k : k + 2], 16) for _, c in colors]) for k in (1, 3, 5)
    ]
    return "#" + "".join(f"{round(float(value)):02x}" for value in channels)


def _bar(scale: ColorScale) -> ColorBar:
    if scale.middle is not None:
        marks = [scale.low, scale.middle, scale.high]
    elif scale.scale is Scale.LOG:
        marks = np.geomspace(scale.low, scale.high, 5).tolist()
    else:
        marks = np.linspace(scale.low, scale.high, 5).tolist()
    return ColorBar(
        title=scale.title,
        stops=SEQUENTIAL if scale.middle is None else DIVERGING,
        ticks=[(round(place(scale, mark), 4), f"{mark:.3g}") for mark in marks],
    )
