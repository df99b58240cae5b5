"""The keys of a figure: its legend and its colour bars."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from bo_tuner.figures.figure import (
    Bars,
    Color,
    ColorScale,
    Contour,
    Dash,
    Figure,
    Heatmap,
    Limit,
    Line,
    Points,
    Region,
    Scale,
)
from bo_tuner.figures.palette import DIVERGING, SEQUENTIAL

STOPS = 33
"""Number of colours for a scale that is logarithmic or diverging."""
SHADES = 255
"""Steps between the shades of a picture."""


@dataclass(frozen=True)
class LegendEntry:
    """The entry for all elements of one name.

    Its ``kind`` is line, bar, area, hatched or a marker's name.
    """

    name: str
    kind: str
    color: Color
    dash: Dash = Dash.SOLID
    filled: bool = True


@dataclass(frozen=True)
class ColorBar:
    """A colour bar: its title, its colours from low to high, and its ticks.

    The positions of ``stops`` and ``ticks`` are between 0 and 1.
    """

    title: str
    stops: Sequence[tuple[float, str]]
    ticks: Sequence[tuple[float, str]]


def legend(figure: Figure) -> list[LegendEntry]:
    """Return the legend entries of a figure, in the order of their first elements."""
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
            case Bars():
                entry = LegendEntry(name, "bar", element.color)
            case Region():
                entry = LegendEntry(name, "hatched" if element.hatched else "area", element.color)
            case _:
                entry = LegendEntry(name, "area", element.color)
        # In the legend, black elements are on the background of the page, not on a heatmap.
        on_page = Color.INK if entry.color is Color.BLACK else entry.color
        entries[name] = replace(entry, color=on_page)
    return list(entries.values())


def color_bars(figure: Figure) -> list[ColorBar]:
    """Return the colour bars of a figure."""
    scales = dict.fromkeys(
        scale
        for panel in figure.panels
        for element in panel.elements
        if (scale := getattr(element, "colors", None)) is not None
    )
    return [_bar(scale) for scale in scales]


def place(scale: ColorScale, value: float) -> float:
    """Return the position of a value on the colour bar, between 0 and 1."""
    if scale.middle is not None:
        if value < scale.middle:
            return 0.5 * (value - scale.low) / (scale.middle - scale.low)
        return 0.5 + 0.5 * (value - scale.middle) / (scale.high - scale.middle)
    if scale.scale is Scale.LOG:
        return math.log(value / scale.low) / math.log(scale.high / scale.low)
    return (value - scale.low) / (scale.high - scale.low)


def color_of(scale: ColorScale, value: float) -> str:
    """Return the colour of a value; beyond the ends of the scale that of the end."""
    at = place(scale, min(max(value, scale.low), scale.high))
    return _shade(scale.middle is not None, round(at * SHADES) / SHADES)


def stops(scale: ColorScale) -> list[tuple[float, str]]:
    """Return colours at positions that are evenly spaced in the value, as Plotly needs them."""
    if scale.middle is None and scale.scale is Scale.LINEAR:
        return list(SEQUENTIAL)
    even = np.linspace(scale.low, scale.high, STOPS)
    return [
        (round(k / (STOPS - 1), 6), _color(scale, place(scale, float(value))))
        for k, value in enumerate(even)
    ]


def _color(scale: ColorScale, at: float) -> str:
    return _shade(scale.middle is not None, at)


@cache
def _shade(is_diverging: bool, at: float) -> str:
    colors = DIVERGING if is_diverging else SEQUENTIAL
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
