"""Panels as SVG within a page: what a reader sees without scripts, and before Plotly has drawn.

The shades are those of the page, so a panel follows its theme. It is a picture without hover texts;
the keys of a figure (`keys`) are the page's.
"""

import base64
import html
import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.figures.figure import (
    Axis,
    Band,
    Bars,
    Color,
    Contour,
    Dash,
    Element,
    Heatmap,
    Limit,
    Line,
    Marker,
    Panel,
    Points,
    Region,
    Scale,
    Values,
)
from bo_tuner.figures.hatching import hatching
from bo_tuner.figures.keys import color_of
from bo_tuner.text import printable

Array = NDArray[np.float64]

LEFT, RIGHT, TOP, BOTTOM = 64, 10, 26, 44
"""Margins around the axes [px]."""
MOST_TICKS = 6
"""Steps between the numbers of an axis, at most."""
SPACE = 0.04
"""Space at the ends of an axis without limits, as a share of its range."""
DASHES = {Dash.SOLID: "", Dash.DASHED: "7 4", Dash.DOTTED: "2 3", Dash.DASH_DOT: "8 3 2 3"}
SHAPES = {
    Marker.CIRCLE: "M-1,0a1,1 0 1 0 2,0a1,1 0 1 0 -2,0z",
    Marker.SQUARE: "M-.9,-.9h1.8v1.8h-1.8z",
    Marker.DIAMOND: "M0,-1.25L1.25,0L0,1.25L-1.25,0z",
    Marker.TRIANGLE: "M0,-1.2L1.1,.8L-1.1,.8z",
    Marker.CROSS: "M-1,-1L1,1M-1,1L1,-1",
    Marker.STAR: "M0,-1.3L.3,-.4L1.24,-.4L.48,.15L.76,1.05L0,.5L-.76,1.05L-.48,.15L-1.24,-.4"
    "L-.3,-.4z",
}
"""Outlines of markers with a radius of 1."""


@dataclass(frozen=True)
class _Ruler:
    """Places [px] of the values of an axis."""

    scale: Scale
    low: float
    high: float
    begin: float
    end: float

    def __call__(self, values: Values | float) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            v = np.asarray(values, dtype=float)
            low, high = self.low, self.high
            if self.scale is Scale.LOG:
                v, low, high = np.log10(v), math.log10(low), math.log10(high)
            place: Array = self.begin + (v - low) / (high - low) * (self.end - self.begin)
        return place


def panel_svg(panel: Panel, width: int, height: int) -> str:
    """Return a panel as an SVG element of a size [px], which scales with its container."""
    x = _ruler(panel, panel.x, "x", 0.0, width - LEFT - RIGHT)
    y = _ruler(panel, panel.y, "y", height - TOP - BOTTOM, 0.0)
    drawn = [part for e in panel.elements for part in _element(e, panel, x, y)]
    return "".join(
        [
            f'<svg viewBox="0 0 {width} {height}" width="100%" height="100%" aria-hidden="true" '
            'font-size="12" fill="var(--ink)">',
            _text(panel.title, LEFT, 14),
            *_frame(panel, x, y, width, height),
            # It ends at its edges.
            f'<svg x="{LEFT}" y="{TOP}" width="{width - LEFT - RIGHT}" '
            f'height="{height - TOP - BOTTOM}">',
            *drawn,
            "</svg></svg>",
        ]
    )


def ticks(axis: Axis, low: float, high: float) -> list[tuple[float, str]]:
    """Return the places and texts along an axis between two values."""
    if axis.ticks:
        return [(place, text) for place, text in axis.ticks if low <= place <= high]
    if axis.scale is Scale.LOG and high >= 10.0 * low:
        powers = range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)
        values = [10.0**k for k in powers][:: -(-len(powers) // MOST_TICKS)]
    else:
        rough = (high - low) / MOST_TICKS
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= rough * (1.0 - 1e-9))
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        values = [k * step for k in range(first, last + 1)]
    return [(value, f"{value + 0.0:.6g}") for value in values]


def _ruler(panel: Panel, axis: Axis, letter: str, begin: float, end: float) -> _Ruler:
    if axis.limits is not None:
        low, high = axis.limits
    else:
        seen = np.concatenate([np.empty(0), *(_extent(e, letter) for e in panel.elements)])
        seen = seen[np.isfinite(seen) & ((seen > 0.0) | (axis.scale is not Scale.LOG))]
        low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.1, 1.0)
        if axis.scale is Scale.LOG:
            spread = (high / low) ** SPACE if high > low else 1.5
            low, high = low / spread, high * spread
        else:
            margin = SPACE * (high - low) or 0.5 * abs(high) or 0.5
            low, high = low - margin, high + margin
    return _Ruler(axis.scale, low, high, begin, end)


def _extent(element: Element, letter: str) -> Array:
    """Return what an element shows along an axis."""
    if isinstance(element, Limit):
        on_axis = element.vertical == (letter == "x")
        return np.array([element.value] if on_axis else [], dtype=float)
    if letter == "x":
        x = np.asarray(element.x, dtype=float)
        half = 0.5 * element.width if isinstance(element, Bars) else 0.0
        return np.concatenate([x - half, x + half])
    match element:
        case Band():
            parts: Iterable[Values] = (element.lower, element.upper)
        case Bars():
            base = np.zeros(len(element.x)) if element.base is None else np.asarray(element.base)
            parts = (base, base + np.asarray(element.y), *_ends(element))
        case Points():
            parts = (element.y, *_ends(element))
        case _:
            parts = (element.y,)
    return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def _ends(element: Points | Bars) -> tuple[Values, Values]:
    if element.low is None or element.high is None:
        return (), ()
    return element.low, element.high


def _frame(panel: Panel, x: _Ruler, y: _Ruler, width: int, height: int) -> Iterator[str]:
    """Yield grid, numbers and titles of the axes."""
    right, bottom = width - RIGHT, height - BOTTOM
    grid = 'stroke="var(--gray)" stroke-opacity=".3"'
    for value, text in ticks(panel.x, x.low, x.high):
        at = LEFT + float(x(value))
        yield f'<path d="M{at:.1f},{TOP}V{bottom}" {grid}/>'
        yield _text(text, at, bottom + 15, "middle")
    for value, text in ticks(panel.y, y.low, y.high):
        at = TOP + float(y(value))
        yield f'<path d="M{LEFT},{at:.1f}H{right}" {grid}/>'
        yield _text(text, LEFT - 5, at + 4, "end")
    yield f'<path d="M{LEFT},{TOP}V{bottom}H{right}" fill="none" stroke="var(--gray)"/>'
    yield _text(panel.x.title, (LEFT + right) / 2, height - 6, "middle")
    yield _text(panel.y.title, -(TOP + bottom) / 2, 12, "middle", ' transform="rotate(-90)"')


def _text(text: str, x: float, y: float, anchor: str = "start", more: str = "") -> str:
    if not text:
        return ""
    lines = html.escape(printable(text)).split("\n")
    spans = "".join(
        f'<tspan x="{x:.1f}" dy="{"1.15em" if k else 0}">{line}</tspan>'
        for k, line in enumerate(lines)
    )
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{spans}</text>'


def _element(element: Element, panel: Panel, x: _Ruler, y: _Ruler) -> Iterator[str]:
    match element:
        case Line():
            yield _stroke(_path(x(element.x), y(element.y), step=element.step), element.color,
                          element.dash, element.width)  # fmt: skip
        case Band():
            around = [np.concatenate([a, b[::-1]]) for a, b in (
                (x(element.x), x(element.x)), (y(element.lower), y(element.upper)))]  # fmt: skip
            kept = np.isfinite(around[0]) & np.isfinite(around[1])
            outline = _path(around[0][kept], around[1][kept])
            yield f'<path d="{outline}z" fill="{_shade(element.color)}" fill-opacity=".2"/>'
        case Points():
            yield from _points(element, x, y)
        case Bars():
            yield from _bars(element, panel, x, y)
        case Heatmap():
            yield _heatmap(element, x, y)
        case Contour():
            for level in element.levels:
                yield _stroke(_level(element, level, x, y), element.color, element.dash,
                              element.width)  # fmt: skip
        case Region():
            if element.hatched:
                across, up = hatching(element)
                lines = _path(x(across), y(up))
                # With a halo, which keeps it visible on any colour of a field.
                yield _stroke(lines, Color.PAPER, Dash.SOLID, 3.0)
                yield _stroke(lines, element.color, Dash.SOLID, 1.2)
            else:
                yield _filled(element, x, y)
        case Limit():
            at = float((x if element.vertical else y)(element.value))
            line = f"M{at:.1f},0V9999" if element.vertical else f"M0,{at:.1f}H9999"
            yield _stroke(line, element.color, element.dash, 1.6)


def _shade(color: Color) -> str:
    return f"var(--{color})"


def _stroke(path: str, color: Color, dash: Dash, width: float) -> str:
    dashes = f' stroke-dasharray="{DASHES[dash]}"' if DASHES[dash] else ""
    return f'<path d="{path}" fill="none" stroke="{_shade(color)}" stroke-width="{width}"{dashes}/>'


def _path(x: Array, y: Array, *, step: bool = False) -> str:
    """Return a path through points (n,) with a gap where one is not finite."""
    parts, begins = [], True
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            begins = True
        elif begins:
            parts.append(f"M{a:.1f},{b:.1f}")
            begins = False
        else:
            parts.append(f"H{a:.1f}V{b:.1f}" if step else f"L{a:.1f},{b:.1f}")
    return "".join(parts)


def _points(points: Points, x: _Ruler, y: _Ruler) -> Iterator[str]:
    places = list(zip(x(points.x).tolist(), y(points.y).tolist(), strict=True))
    if points.low is not None and points.high is not None:
        for (a, _), low, high in zip(places, y(points.low), y(points.high), strict=True):
            yield _stroke(f"M{a:.1f},{low:.1f}V{high:.1f}", points.color, Dash.SOLID, 1.4)
    radius, crossed = 0.62 * points.size, points.marker is Marker.CROSS
    shades: Sequence[str] = [_shade(points.color)] * len(places)
    edge = "var(--paper)"
    if points.values is not None and points.colors is not None:
        shades = [color_of(points.colors, float(value)) for value in points.values]
        edge = "var(--black)"
    for (a, b), shade in zip(places, shades, strict=True):
        if math.isfinite(a) and math.isfinite(b):
            hollow = crossed or not points.filled
            style = f'fill="none" stroke="{shade}" stroke-width="{1.6 / radius:.2f}"'
            if not hollow:
                style = f'fill="{shade}" stroke="{edge}" stroke-width="{1 / radius:.2f}"'
            yield (
                f'<path d="{SHAPES[points.marker]}" {style} '
                f'transform="translate({a:.1f},{b:.1f}) scale({radius:.2f})"/>'
            )


def _bars(bars: Bars, panel: Panel, x: _Ruler, y: _Ruler) -> Iterator[str]:
    centres, width = np.asarray(bars.x, dtype=float), bars.width
    base = np.zeros(len(centres))
    if bars.base is None:
        together = [e for e in panel.elements if isinstance(e, Bars) and e.base is None]
        width /= len(together)
        place = next(k for k, other in enumerate(together) if other is bars)
        centres = centres + width * (place - (len(together) - 1) / 2.0)
    else:
        base = np.asarray(bars.base, dtype=float)
    left, right = x(centres - width / 2.0), x(centres + width / 2.0)
    ends = y(base), y(base + np.asarray(bars.y, dtype=float))
    for a, b, low, high in zip(left, right, *ends, strict=True):
        if np.isfinite([low, high]).all():
            yield (
                f'<rect x="{a:.1f}" y="{min(low, high):.1f}" width="{b - a:.1f}" '
                f'height="{abs(high - low):.1f}" fill="{_shade(bars.color)}"/>'
            )
    if bars.low is not None and bars.high is not None:
        for a, low, high in zip(x(centres), y(bars.low), y(bars.high), strict=True):
            yield _stroke(f"M{a:.1f},{low:.1f}V{high:.1f}", Color.INK, Dash.SOLID, 1.4)


def _edges(places: Array) -> Array:
    """Return the borders (n + 1,) of the cells around places (n,) [px]."""
    if len(places) < 2:
        return np.array([places[0] - 20.0, places[0] + 20.0])
    middles = (places[:-1] + places[1:]) / 2.0
    return np.concatenate(
        [[2.0 * places[0] - middles[0]], middles, [2.0 * places[-1] - middles[-1]]]
    )


def _heatmap(heatmap: Heatmap, x: _Ruler, y: _Ruler) -> str:
    """Return a picture with a pixel for each cell: the grids are even on the scales of the axes."""
    across, up = _edges(x(heatmap.x)), _edges(y(heatmap.y))
    rows = [
        b"\0"
        + b"".join(
            bytes.fromhex(f"{color_of(heatmap.colors, float(v))[1:]}ff")
            if math.isfinite(v)
            else bytes(4)
            for v in row
        )
        for row in heatmap.z[::-1]
    ]
    picture = base64.b64encode(_png(len(heatmap.x), len(heatmap.y), b"".join(rows))).decode()
    return (
        f'<image x="{across[0]:.1f}" y="{up[-1]:.1f}" width="{across[-1] - across[0]:.1f}" '
        f'height="{up[0] - up[-1]:.1f}" preserveAspectRatio="none" '
        f'style="image-rendering: pixelated" href="data:image/png;base64,{picture}"/>'
    )


def _png(width: int, height: int, rows: bytes) -> bytes:
    """Return a PNG file of rows of RGBA pixels, each row behind a zero (ISO/IEC 15948)."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows, 9))
        + chunk(b"IEND", b"")
    )


def _filled(region: Region, x: _Ruler, y: _Ruler) -> str:
    across, up = _edges(x(region.x)), _edges(y(region.y))
    cells = "".join(
        f"M{across[j]:.1f},{up[i]:.1f}H{across[j + 1]:.1f}V{up[i + 1]:.1f}H{across[j]:.1f}z"
        for i, j in np.argwhere(region.z > region.above)
    )
    return f'<path d="{cells}" fill="{_shade(region.color)}" fill-opacity=".4"/>'


def _level(contour: Contour, level: float, x: _Ruler, y: _Ruler) -> str:
    """Return the line along which a field has a level, by the sides of cells that it crosses."""
    across, up, z = x(contour.x), y(contour.y), contour.z - level
    parts = []
    for i in range(len(up) - 1):
        for j in range(len(across) - 1):
            corners = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
            if not all(math.isfinite(z[corner]) for corner in corners):
                continue
            sides = zip(corners, corners[1:] + corners[:1], strict=True)
            crossings = [
                _crossing(z, a, b, across, up) for a, b in sides if (z[a] > 0) != (z[b] > 0)
            ]
            for (a, b), (c, d) in zip(crossings[::2], crossings[1::2], strict=True):
                parts.append(f"M{a:.1f},{b:.1f}L{c:.1f},{d:.1f}")
    return "".join(parts)


def _crossing(
    z: Array, a: tuple[int, int], b: tuple[int, int], across: Array, up: Array
) -> tuple[float, float]:
    """Return the place between two corners of a cell at which a field is 0."""
    share = float(z[a] / (z[a] - z[b]))
    return (
        float(across[a[1]] + share * (across[b[1]] - across[a[1]])),
        float(up[a[0]] + share * (up[b[0]] - up[a[0]])),
    )
