"""Elements of a panel as Plotly traces; colours remain names, see `plotly_renderer`."""

import html
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bo_tuner.figures.figure import (
    Band,
    Bars,
    Color,
    Contour,
    Dash,
    Element,
    Grid,
    Heatmap,
    Limit,
    Line,
    Marker,
    Points,
    Region,
    Values,
)
from bo_tuner.figures.hatching import hatching
from bo_tuner.figures.keys import stops
from bo_tuner.text import printable

DIGITS = 6
"""Significant digits of the data: more than is visible, few enough to keep the page small."""

MARKERS = {
    Marker.CIRCLE: "circle",
    Marker.SQUARE: "square",
    Marker.DIAMOND: "diamond",
    Marker.TRIANGLE: "triangle-up",
    Marker.CROSS: "x-thin",
    Marker.STAR: "star",
}
DASHES = {Dash.SOLID: "solid", Dash.DASHED: "dash", Dash.DOTTED: "dot", Dash.DASH_DOT: "dashdot"}
PIXELS_PER_POINT = 4.0 / 3.0


Trace = dict[str, Any]


def traces(element: Element) -> list[Trace]:
    """Return the traces of an element; none for a limit, which is a shape of the layout."""
    match element:
        case Line():
            return [_line(element)]
        case Band():
            return [_band(element)]
        case Points():
            return [_points(element)]
        case Bars():
            return [_bars(element)]
        case Heatmap():
            return [_heatmap(element)]
        case Contour():
            return [_contour(element, level) for level in element.levels]
        case Region():
            return _region(element)
        case Limit():
            return []


def _line(line: Line) -> Trace:
    style = {"color": f"@{line.color}", "dash": DASHES[line.dash], "width": line.width}
    if line.step:
        style["shape"] = "hv"
    return {
        "type": "scatter",
        "mode": "lines",
        "name": text_of(line.name),
        "x": _numbers(line.x),
        "y": _numbers(line.y),
        "line": style,
        **_trials(line.trials),
    } | _hover(line.hover, "x+y+name" if line.name else "x+y")


def _band(band: Band) -> Trace:
    # One closed outline: forward along the lower edge and back along the upper one.
    x, low, high = _numbers(band.x), _numbers(band.lower), _numbers(band.upper)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": text_of(band.name),
        "x": x + x[::-1],
        "y": low + high[::-1],
        "fill": "toself",
        "fillcolor": f"@{band.color}/0.18",
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def _points(points: Points) -> Trace:
    marker: dict[str, Any] = {
        "size": points.size * PIXELS_PER_POINT,
        "symbol": MARKERS[points.marker],
        "color": f"@{points.color}",
        # An outline makes it visible on heatmaps and other points.
        "line": {"width": 1, "color": f"@{Color.PAPER}"},
    }
    if points.values is not None and points.colors is not None:
        marker |= {
            "color": _numbers(points.values),
            "colorscale": stops(points.colors),
            "cmin": points.colors.low,
            "cmax": points.colors.high,
            "line": {"width": 1, "color": f"@{Color.BLACK}"},
        }
    elif points.marker is Marker.CROSS:
        marker["line"] = {"width": 2.5, "color": f"@{points.color}"}
    elif not points.filled:
        marker["symbol"] += "-open"
        marker["line"] = {"width": 1.6}
    trace: Trace = {
        "type": "scatter",
        "mode": "markers",
        "name": text_of(points.name),
        "x": _numbers(points.x),
        "y": _numbers(points.y),
        "marker": marker,
        "cliponaxis": False,
        **_trials(points.trials),
    } | _hover(points.hover, "x+y+name" if points.name else "x+y")
    if points.low is not None and points.high is not None:
        trace["error_y"] = _errors(points.y, points.low, points.high, f"@{points.color}")
    return trace


def _bars(bars: Bars) -> Trace:
    trace: Trace = {
        "type": "bar",
        "name": text_of(bars.name),
        "x": _numbers(bars.x),
        "y": _numbers(bars.y),
        "marker": {"color": f"@{bars.color}"},
    } | _hover(bars.hover, "x+y+name" if bars.name else "x+y")
    if bars.base is not None:
        trace |= {"base": _numbers(bars.base), "width": bars.width}
    if bars.low is not None and bars.high is not None:
        top = np.asarray(bars.y, dtype=float) + (
            0.0 if bars.base is None else np.asarray(bars.base, dtype=float)
        )
        trace["error_y"] = _errors(top, bars.low, bars.high, "@ink")
    return trace


def _heatmap(heatmap: Heatmap) -> Trace:
    scale = heatmap.colors
    return {
        "type": "heatmap",
        "x": _numbers(heatmap.x),
        "y": _numbers(heatmap.y),
        "z": _rows(heatmap.z),
        "zmin": scale.low,
        "zmax": scale.high,
        "colorscale": stops(scale),
        "showscale": False,
        "zhoverformat": ".4g",
        "hoverinfo": "x+y+z",
        "hoverongaps": False,
    }


def _contour(contour: Contour, level: float) -> Trace:
    return {
        "type": "contour",
        "name": text_of(contour.name),
        "x": _numbers(contour.x),
        "y": _numbers(contour.y),
        "z": _rows(contour.z),
        "autocontour": False,
        "contours": {
            "start": level,
            "end": level,
            "size": 1.0,
            "coloring": "none",
            "showlabels": contour.labelled,
        },
        "line": {
            "color": f"@{contour.color}",
            "dash": DASHES[contour.dash],
            "width": contour.width,
        },
        "showscale": False,
        "hoverinfo": "skip",
    }


def _region(region: Region) -> list[Trace]:
    if not region.hatched:
        shade = {
            "type": "contour",
            "name": text_of(region.name),
            "x": _numbers(region.x),
            "y": _numbers(region.y),
            "z": _rows(region.z),
            # Plotly shades the region where the constraint is violated.
            "contours": {"type": "constraint", "operation": "<=", "value": region.above},
            "fillcolor": f"@{region.color}/0.4",
            "line": {"width": 0},
            "showscale": False,
            "hoverinfo": "skip",
        }
        return [shade]
    x, y = map(_numbers, hatching(region))
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": text_of(region.name),
            "x": x,
            "y": y,
            "line": {"color": color, "width": width},
            "hoverinfo": "skip",
        }
        # With a halo, which keeps it visible on any colour of a field.
        for color, width in ((f"@{Color.PAPER}/0.6", 3.0), (f"@{region.color}", 1.2))
    ]


def _trials(numbers: Sequence[int]) -> Trace:
    """Return what lets a point lead to its trial."""
    return {"customdata": list(numbers)} if numbers else {}


def _hover(texts: Sequence[str], otherwise: str) -> Trace:
    if not texts:
        return {"hoverinfo": otherwise}
    return {"hoverinfo": "text", "hovertext": [text_of(text) for text in texts]}


def _errors(y: Values, low: Values, high: Values, color: str) -> dict[str, Any]:
    middle = np.asarray(y, dtype=float)
    return {
        "type": "data",
        "symmetric": False,
        "array": _numbers(np.asarray(high, dtype=float) - middle),
        "arrayminus": _numbers(middle - np.asarray(low, dtype=float)),
        "color": color,
        "thickness": 1.4,
        "width": 3,
    }


def text_of(text: str) -> str:
    """Escape what Plotly would interpret as markup, or a browser; line breaks become its own."""
    return html.escape(printable(text), quote=False).replace("\n", "<br>")


def _numbers(values: Values) -> list[float | None]:
    return [_rounded(float(value)) for value in values]


def _rows(z: Grid) -> list[list[float | None]]:
    return [[_rounded(float(value)) for value in row] for row in z]


def _rounded(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
