"""Panels as SVG within a page: they fit any size, follow its theme, and need no script.

What has an extent is drawn in a square of `SIDE` units that is stretched over the axes, and what
keeps its form, marks and text, is placed in percent of them. The page has the symbols of the marks
(`symbols`) and the keys of a figure (`keys`); its script adds tips, links and zoom (`figures.js`).
"""

import base64
import html
import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
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
    Figure,
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

SIDE = 1000
"""Side of the square that is stretched over the axes."""
TOP, BARE_TOP, BOTTOM, BARE_BOTTOM = 26, 8, 44, 24
"""Margins above and below the axes [px], bare ones without a title there."""
CHARACTER = 7.0
"""Mean width of a character [px]."""
LONG = 80
"""Tick labels with more characters in total do not fit side by side."""
MOST_TICKS = 6
"""Steps between the numbers of an axis, at most."""
STEP_HEIGHT = 25
"""Least distance of two numbers above one another [px]."""
SPACE = 0.04
"""Space at the ends of an axis without limits, as a share of its range."""
PIXELS = 160
"""Of a field along an axis on which its values are not evenly spaced."""
DIGITS = 4
"""Significant digits of a field's values."""
DASHES = {Dash.SOLID: "", Dash.DASHED: "7 4", Dash.DOTTED: "2 3", Dash.DASH_DOT: "8 3 2 3"}
REACH = 1.3
"""How far a mark reaches from its middle, in multiples of its radius."""
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
RINGS = ((Color.BLACK, 5.0), (Color.WHITE, 3.0))
"""Around a mark on a field, with their widths [px]: one of them is seen on any colour."""


def symbols() -> str:
    """Return the marks as symbols of a page, by the names of their markers."""
    view = f"{-REACH} {-REACH} {2 * REACH} {2 * REACH}"
    return "".join(
        f'<symbol id="mark-{marker}" viewBox="{view}" overflow="visible"><path d="{shape}"/>'
        "</symbol>"
        for marker, shape in SHAPES.items()
    )


def hover_texts(figure: Figure) -> list[str]:
    """Return the texts of a figure's points, each once: its panels show the same trials."""
    of_elements = (getattr(e, "hover", ()) for panel in figure.panels for e in panel.elements)
    return list(dict.fromkeys(printable(text) for texts in of_elements for text in texts))


def panels_svg(figure: Figure) -> list[str]:
    """Return each panel of a figure; ``data-tip`` is a place in its `hover_texts`."""
    places = {text: place for place, text in enumerate(hover_texts(figure))}
    return [panel_svg(panel, figure.panel_height, places) for panel in figure.panels]


@dataclass(frozen=True)
class _Ruler:
    """Places of the values of an axis, from 0 at its lower end to 1."""

    scale: Scale
    low: float
    high: float
    named: bool = False

    def __call__(self, values: Values | float) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            v = np.asarray(values, dtype=float)
            low, high = self.low, self.high
            if self.scale is Scale.LOG:
                v, low, high = np.log10(v), math.log10(low), math.log10(high)
            place: Array = (v - low) / (high - low)
        return place

    @property
    def words(self) -> str:
        """What the script needs to know of it; on an axis with names there is no zoom."""
        return f"{self.low:.9g} {self.high:.9g} {self.scale}{' named' if self.named else ''}"


@dataclass(frozen=True)
class _Axes:
    """Places of points on both axes."""

    x: _Ruler
    y: _Ruler

    def across(self, values: Values | float) -> Array:
        """Return places from the left, in the stretched square."""
        return SIDE * self.x(values)

    def down(self, values: Values | float) -> Array:
        """Return places from the top, in the stretched square."""
        return SIDE * (1.0 - self.y(values))


def panel_svg(panel: Panel, height: int, texts: Mapping[str, int] | None = None) -> str:
    """Return a panel of a height [px] as an SVG element that lies over its container."""
    axes = _Axes(_ruler(panel, panel.x, "x"), _ruler(panel, panel.y, "y"))
    title, label = panel.title, panel.y.title
    bottom = BOTTOM if panel.x.title else BARE_BOTTOM
    if len(label) * CHARACTER > height - TOP - bottom:
        # In such a low panel the label of the y axis would be cropped.
        title, label = ": ".join(part for part in (title, label) if part), ""
    top = TOP if title else BARE_TOP
    steps = min(MOST_TICKS, max(2, (height - top - bottom) // STEP_HEIGHT))
    is_field = any(isinstance(e, Heatmap) for e in panel.elements)
    return "".join(
        [
            f'<svg class="axes" style="--top: {top}px; --bottom: {bottom}px" aria-hidden="true" '
            f'font-size="12" fill="var(--ink)" data-x="{axes.x.words}" data-y="{axes.y.words}" '
            f'data-labels="{html.escape(printable(panel.x.title))}\n'
            f'{html.escape(printable(panel.y.title))}">',
            _text(title, "0", "-12", "start"),
            '<g class="ticks">',
            *_ticks_across(panel.x, axes.x),
            *_ticks_up(panel.y, axes.y, steps),
            "</g>",
            '<g stroke="var(--gray)"><line y2="100%"/><line y1="100%" x2="100%" y2="100%"/></g>',
            _text(panel.x.title, "50%", "100%", "middle", ' dy="38"'),
            '<svg y="50%" overflow="visible">',
            _text(label, "0", "-50", "middle", ' transform="rotate(-90)"'),
            "</svg>",
            *(_element(e, panel, axes, texts or {}, on_field=is_field) for e in panel.elements),
            "</svg>",
        ]
    )


def ticks(axis: Axis, low: float, high: float, most: int = MOST_TICKS) -> list[tuple[float, str]]:
    """Return the places and texts along an axis between two values."""
    if axis.ticks:
        return [(place, text) for place, text in axis.ticks if low <= place <= high]
    if axis.scale is Scale.LOG and high >= 10.0 * low:
        powers = range(math.floor(math.log10(low)), math.floor(math.log10(high) + 1e-9) + 1)
        digits = (1.0, 2.0, 5.0) if high < 100.0 * low and most == MOST_TICKS else (1.0,)
        values = [k * 10.0**power for power in powers for k in digits]
        within = [v for v in values if low * (1.0 - 1e-9) <= v <= high * (1.0 + 1e-9)]
        values = within[:: -(-len(within) // (most + 1))]
    else:
        rough = (high - low) / most
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= rough * (1.0 - 1e-9))
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        values = [k * step for k in range(first, last + 1)]
    return [(value, f"{value + 0.0:.6g}") for value in values]


def _ruler(panel: Panel, axis: Axis, letter: str) -> _Ruler:
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
    return _Ruler(axis.scale, low, high, bool(axis.ticks))


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


GRID = 'stroke="var(--gray)" stroke-opacity=".3"'


def _ticks_across(axis: Axis, ruler: _Ruler) -> Iterator[str]:
    marks = ticks(axis, ruler.low, ruler.high)
    anchor, turned = "middle", ""
    if sum(len(text) for _, text in marks) > LONG:
        anchor, turned = "end", ' transform="rotate(-30)"'
    for value, text in marks:
        at = f"{100.0 * float(ruler(value)):.2f}%"
        yield f'<line x1="{at}" x2="{at}" y2="100%" {GRID}/>'
        if turned:
            words = _text(text, "0", "0", anchor, f' dy="15"{turned}')
            yield f'<svg x="{at}" y="100%" overflow="visible">{words}</svg>'
        else:
            yield _text(text, at, "100%", anchor, ' dy="15"')


def _ticks_up(axis: Axis, ruler: _Ruler, most: int) -> Iterator[str]:
    for value, text in ticks(axis, ruler.low, ruler.high, most):
        at = f"{100.0 - 100.0 * float(ruler(value)):.2f}%"
        yield f'<line y1="{at}" x2="100%" y2="{at}" {GRID}/>'
        yield _text(text, "-5", at, "end", ' dy="4"')


def _text(text: str, x: str, y: str, anchor: str, more: str = "") -> str:
    if not text:
        return ""
    first, *others = html.escape(printable(text)).split("\n")
    below = "".join(f'<tspan x="{x}" dy="1.15em">{line}</tspan>' for line in others)
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}"{more}>{first}{below}</text>'


def _element(
    element: Element, panel: Panel, axes: _Axes, texts: Mapping[str, int], *, on_field: bool
) -> str:
    """Return an element in a group with its name, by which the legend hides it."""
    marks: Iterable[str] = ()
    match element:
        case Line():
            drawn: Iterable[str] = [_line(element, axes)]
            marks = _spots(element, axes, texts)
        case Band():
            drawn = [_band(element, axes)]
        case Points():
            drawn = _error_bars(element, element.color, axes)
            marks = _marks(element, axes, texts, on_field=on_field)
        case Bars():
            drawn = _bars(element, panel, axes)
        case Heatmap():
            drawn = [_heatmap(element, axes)]
        case Contour():
            drawn = [
                _stroke(_level(element, level, axes), element.color, element.dash, element.width)
                for level in element.levels
            ]
        case Region():
            drawn = _region(element, panel, axes)
        case Limit():
            at = float((axes.across if element.vertical else axes.down)(element.value))
            path = f"M{at:.1f},0V{SIDE}" if element.vertical else f"M0,{at:.1f}H{SIDE}"
            drawn = [_stroke(path, element.color, element.dash, 1.6)]
    stretched = "".join(drawn)
    if stretched:
        view = f'viewBox="0 0 {SIDE} {SIDE}" preserveAspectRatio="none"'
        stretched = f'<svg class="stretched" {view}>{stretched}</svg>'
    name = html.escape(printable(getattr(element, "name", "")))
    return f'<g data-name="{name}">{stretched}{"".join(marks)}</g>'


def _shade(color: Color) -> str:
    return f"var(--{color})"


def _stroke(path: str, color: Color, dash: Dash, width: float, more: str = "") -> str:
    dashes = f' stroke-dasharray="{DASHES[dash]}"' if DASHES[dash] else ""
    return (
        f'<path d="{path}" fill="none" stroke="{_shade(color)}" stroke-width="{width}"{dashes} '
        f'vector-effect="non-scaling-stroke"{more}/>'
    )


def _path(x: Array, y: Array, *, step: bool = False) -> str:
    """Return a path through points (n,) with a gap where one is not finite."""
    parts, before = [], math.nan
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            before = math.nan
            continue
        if step and math.isfinite(before):
            parts.append(f"L{a:.1f},{before:.1f}")
        parts.append(f"{'L' if math.isfinite(before) else 'M'}{a:.1f},{b:.1f}")
        before = b
    return "".join(parts)


def _line(line: Line, axes: _Axes) -> str:
    path = _path(axes.across(line.x), axes.down(line.y), step=line.step)
    # Points with a text of their own have the tip.
    traced = "" if line.hover else ' class="traced"'
    return _stroke(path, line.color, line.dash, line.width, traced)


def _spots(line: Line, axes: _Axes, texts: Mapping[str, int]) -> Iterator[str]:
    """Yield places with a tip, which are not seen."""
    if line.hover:
        for k, (a, b) in enumerate(zip(axes.x(line.x), axes.y(line.y), strict=True)):
            if 0.0 <= a <= 1.0 and 0.0 <= b <= 1.0:
                yield f"<use {_place(a, b)}{_of_point(line, k, texts)}/>"


def _band(band: Band, axes: _Axes) -> str:
    x, low, high = axes.across(band.x), axes.down(band.lower), axes.down(band.upper)
    around = np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]])
    kept = np.isfinite(around[0]) & np.isfinite(around[1])
    outline = _path(around[0][kept], around[1][kept])
    return f'<path d="{outline}z" fill="{_shade(band.color)}" fill-opacity=".2"/>'


def _place(across: float, up: float) -> str:
    return f'x="{100.0 * across:.2f}%" y="{100.0 - 100.0 * up:.2f}%"'


def _of_point(element: Line | Points, k: int, texts: Mapping[str, int]) -> str:
    """Return what the script needs of a point: the place of its text, and its trial."""
    place = texts.get(printable(element.hover[k])) if len(element.hover) else None
    tip = "" if place is None else f' data-tip="{place}"'
    return f'{tip} data-trial="{element.trials[k]}"' if len(element.trials) else tip


def _error_bars(
    element: Points | Bars, color: Color, axes: _Axes, x: Array | None = None
) -> Iterator[str]:
    if element.low is None or element.high is None:
        return
    across = axes.across(element.x) if x is None else x
    for a, low, high in zip(across, axes.down(element.low), axes.down(element.high), strict=True):
        if np.isfinite([a, low, high]).all():
            yield _stroke(f"M{a:.1f},{low:.1f}V{high:.1f}", color, Dash.SOLID, 1.4)


def _marks(
    points: Points, axes: _Axes, texts: Mapping[str, int], *, on_field: bool
) -> Iterator[str]:
    """Yield the marks, on a field within rings."""
    radius = 0.62 * points.size
    size = 2.0 * REACH * radius
    crossed = points.marker is Marker.CROSS
    shown = [
        (k, a, b)
        for k, (a, b) in enumerate(zip(axes.x(points.x), axes.y(points.y), strict=True))
        if -1e-9 <= a <= 1.0 + 1e-9 and -1e-9 <= b <= 1.0 + 1e-9
    ]
    head = f'<use href="#mark-{points.marker}" width="{size:.1f}" height="{size:.1f}"'

    def group(style: str, uses: Iterable[str]) -> str:
        return (
            f'<g transform="translate({-size / 2:.2f},{-size / 2:.2f})" {style}>{"".join(uses)}</g>'
        )

    places = [f"{head} {_place(a, b)}" for _, a, b in shown]
    if on_field:
        for color, width in RINGS:
            ring = f'fill="none" stroke="{_shade(color)}" stroke-width="{width / radius:.2f}"'
            yield group(ring, (f"{place}/>" for place in places))
    shade = _shade(points.color)
    if crossed or not points.filled:
        style = f'fill="none" stroke="{shade}" stroke-width="{1.6 / radius:.2f}"'
    else:
        edge = _shade(Color.PAPER if points.values is None else Color.BLACK)
        style = f'fill="{shade}" stroke="{edge}" stroke-width="{1 / radius:.2f}"'
    colors = [""] * len(shown)
    if points.values is not None and points.colors is not None:
        values = points.values
        colors = [f' fill="{color_of(points.colors, float(values[k]))}"' for k, *_ in shown]
    yield group(
        style,
        (
            f"{place}{color}{_of_point(points, k, texts)}/>"
            for place, color, (k, *_) in zip(places, colors, shown, strict=True)
        ),
    )


def _bars(bars: Bars, panel: Panel, axes: _Axes) -> Iterator[str]:
    centres, width = np.asarray(bars.x, dtype=float), bars.width
    base = np.zeros(len(centres))
    if bars.base is None:
        together = [e for e in panel.elements if isinstance(e, Bars) and e.base is None]
        width /= len(together)
        place = next(k for k, other in enumerate(together) if other is bars)
        centres = centres + width * (place - (len(together) - 1) / 2.0)
    else:
        base = np.asarray(bars.base, dtype=float)
    left, right = axes.across(centres - width / 2.0), axes.across(centres + width / 2.0)
    ends = axes.down(base), axes.down(base + np.asarray(bars.y, dtype=float))
    for k, (a, b, low, high) in enumerate(zip(left, right, *ends, strict=True)):
        if np.isfinite([low, high]).all():
            text = bars.hover[k] if len(bars.hover) else f"{bars.name} {bars.y[k]:.4g}".strip()
            yield (
                f'<rect x="{a:.1f}" y="{min(low, high):.1f}" width="{b - a:.1f}" '
                f'height="{abs(high - low):.1f}" fill="{_shade(bars.color)}">'
                f"<title>{html.escape(printable(text))}</title></rect>"
            )
    yield from _error_bars(bars, Color.INK, axes, axes.across(centres))


def _edges(places: Array) -> Array:
    """Return the borders (n + 1,) of the cells around places (n,)."""
    if len(places) < 2:
        return np.array([places[0] - 40.0, places[0] + 40.0])
    middles = (places[:-1] + places[1:]) / 2.0
    return np.concatenate(
        [[2.0 * places[0] - middles[0]], middles, [2.0 * places[-1] - middles[-1]]]
    )


def _evenly(edges: Array) -> list[int]:
    """Return which cell stands at each of the pixels (m,) of a picture, by the cells' borders."""
    widths = np.abs(np.diff(edges))
    if np.allclose(widths, widths[0], rtol=1e-3):
        return list(range(len(widths)))
    pixels = np.linspace(edges[0], edges[-1], 2 * PIXELS + 1)[1::2]
    rising = edges[0] < edges[-1]
    found = np.searchsorted(edges if rising else -edges, pixels if rising else -pixels) - 1
    cells: list[int] = np.clip(found, 0, len(widths) - 1).tolist()
    return cells


def _heatmap(heatmap: Heatmap, axes: _Axes) -> str:
    """Return a picture with a pixel for each cell, or more where cells are not of one size."""
    x, y = axes.across(heatmap.x), axes.down(heatmap.y)
    across, up = _edges(x), _edges(y)
    columns, lines = _evenly(across), _evenly(up)[::-1]
    cells = [
        [
            bytes.fromhex(f"{color_of(heatmap.colors, float(v))[1:]}ff")
            if math.isfinite(v)
            else bytes(4)
            for v in row
        ]
        for row in heatmap.z
    ]
    rows = b"".join(b"\0" + b"".join(cells[i][j] for j in columns) for i in lines)
    picture = base64.b64encode(_png(len(columns), len(lines), rows)).decode()
    values = ";".join(
        ",".join(f"{v:.{DIGITS}g}" if math.isfinite(v) else "" for v in row) for row in heatmap.z
    )
    places = (",".join(f"{place:.1f}" for place in each) for each in (x, y))
    return (
        f'<image x="{across[0]:.1f}" y="{up[-1]:.1f}" width="{across[-1] - across[0]:.1f}" '
        f'height="{up[0] - up[-1]:.1f}" preserveAspectRatio="none" '
        f'style="image-rendering: pixelated" data-places="{";".join(places)}" '
        f'data-values="{values}" href="data:image/png;base64,{picture}"/>'
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


def _region(region: Region, panel: Panel, axes: _Axes) -> Iterator[str]:
    if not region.hatched:
        across, up = _edges(axes.across(region.x)), _edges(axes.down(region.y))
        cells = "".join(
            f"M{across[j]:.1f},{up[i]:.1f}H{across[j + 1]:.1f}V{up[i + 1]:.1f}H{across[j]:.1f}z"
            for i, j in np.argwhere(region.z > region.above)
        )
        yield f'<path d="{cells}" fill="{_shade(region.color)}" fill-opacity=".4"/>'
        return
    across, up = hatching(region, panel.x.scale, panel.y.scale)
    lines = _path(axes.across(across), axes.down(up))
    # With a halo, which keeps it visible on any colour of a field.
    yield _stroke(lines, Color.PAPER, Dash.SOLID, 3.0)
    yield _stroke(lines, region.color, Dash.SOLID, 1.2)


def _level(contour: Contour, level: float, axes: _Axes) -> str:
    """Return the line along which a field has a level, by the sides of cells that it crosses."""
    across, up, z = axes.across(contour.x), axes.down(contour.y), contour.z - level
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
