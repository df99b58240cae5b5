"""Figures as PNG and SVG files, by Matplotlib.

No window system is needed, and the same figure gives the same bytes: no date, fixed identifiers.
"""

import io
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, TwoSlopeNorm, to_rgba
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import AutoLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from bo_tuner.figures.figure import (
    Axis,
    Band,
    Bars,
    Color,
    ColorScale,
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
from bo_tuner.figures.palette import DIVERGING, LIGHT, SEQUENTIAL
from bo_tuner.text import printable

PANEL_WIDTH = 5.2
"""Width of a panel [inch]."""

RESOLUTION = 150
"""Resolution of PNG files [dots per inch]."""

LITTLE = 4.0
"""Ratio of the ends of a logarithmic axis below which steps of 1, 2, 5 are too wide."""

MOST_STEPS = 6
"""Largest number of steps between the numbers of a horizontal axis, which may be long, as 0.00125.

Matplotlib allows nine, and takes each number for three letters wide.
"""

LETTER = 0.08
"""Width of a wide letter in the legend [inch], in the font of `STYLE`."""

LEGEND_KEY = 0.6
"""Width of a symbol in the legend with the gap behind its name [inch]."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dfe3e7",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "text.parse_math": False,  # names may contain $ and _
    "text.usetex": False,
    "svg.hashsalt": "bo_tuner",
    "svg.fonttype": "path",
}

MARKERS = {
    Marker.CIRCLE: "o",
    Marker.SQUARE: "s",
    Marker.DIAMOND: "D",
    Marker.TRIANGLE: "^",
    Marker.CROSS: "x",
    Marker.STAR: "*",
}
DASHES: Mapping[Dash, Any] = {
    Dash.SOLID: "-",
    Dash.DASHED: "--",
    Dash.DOTTED: ":",
    Dash.DASH_DOT: "-.",
}
PLAIN = FuncFormatter(lambda value, _: f"{value:.4g}")
"""Plain numbers: powers of ten would need the markup that is off for names."""


def render(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file of a format, ``png`` or ``svg``."""
    # Without a date, so that equal figures are equal files.
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        sheet = draw(figure)
        sheet.savefig(buffer, format=kind, dpi=RESOLUTION, metadata=metadata)
    return buffer.getvalue()


def draw(figure: Figure) -> Sheet:
    """Draw a figure on a Matplotlib figure."""
    height = figure.panel_height / 96.0
    sheet = Sheet(
        figsize=(PANEL_WIDTH * figure.columns, height * figure.rows + 0.8), layout="constrained"
    )
    FigureCanvasAgg(sheet)
    axes = sheet.subplots(figure.rows, figure.columns, squeeze=False).ravel()
    legend: dict[str, Any] = {}
    bars: dict[ColorScale, tuple[Any, list[Any]]] = {}
    for ax, panel in zip(axes, figure.panels, strict=False):
        _panel(ax, panel, legend)
        for element in panel.elements:
            scale = getattr(element, "colors", None)
            if scale is not None:
                bars.setdefault(scale, (_mappable(scale), []))[1].append(ax)
    for ax in axes[len(figure.panels) :]:
        ax.set_axis_off()
    for scale, (mappable, of_axes) in bars.items():
        bar = sheet.colorbar(mappable, ax=of_axes, label=printable(scale.title), format=PLAIN)
        if scale.scale is Scale.LOG:
            bar.set_ticks(np.geomspace(scale.low, scale.high, 5).tolist())
            bar.minorticks_off()
    sheet.suptitle(
        "\n".join(textwrap.wrap(printable(figure.title), 46 * figure.columns)),
        fontweight="bold",
        fontsize=11,
    )
    if legend:
        sheet.legend(
            list(legend.values()),
            list(legend),
            loc="outside lower center",
            ncols=_legend_columns(legend, PANEL_WIDTH * figure.columns),
        )
    return sheet


def _legend_columns(names: Iterable[str], width: float) -> int:
    """Return the number of legend columns that fit into a width [inch]."""
    letters = [len(name) for name in names]
    return max(1, min(len(letters), int(width / (LEGEND_KEY + LETTER * max(letters)))))


def _panel(ax: Any, panel: Panel, legend: dict[str, Any]) -> None:
    _axis(panel.x, ax.xaxis, ax.set_xscale, ax.set_xlabel, ax.set_xlim, ax.set_xticks)
    _axis(panel.y, ax.yaxis, ax.set_yscale, ax.set_ylabel, ax.set_ylim, ax.set_yticks)
    ax.set_title(printable(panel.title), loc="left")
    together = [e for e in panel.elements if isinstance(e, Bars) and e.base is None]
    for order, element in enumerate(panel.elements):
        handle = _element(ax, element, together, order + 2)
        name = printable(getattr(element, "name", ""))
        if name and handle is not None:
            legend.setdefault(name, handle)
    for ticks in (ax.xaxis, ax.yaxis):
        low, high = sorted(ticks.get_view_interval())
        if isinstance(ticks.get_major_locator(), LogLocator) and high < LITTLE * low:
            ticks.set_major_locator(AutoLocator())
    if isinstance(ax.xaxis.get_major_locator(), AutoLocator):
        ax.xaxis.set_major_locator(MaxNLocator(MOST_STEPS, steps=[1, 2, 5, 10]))


def _axis(
    axis: Axis,
    ticks: Any,
    set_scale: Callable[..., Any],
    set_label: Callable[..., Any],
    set_limits: Callable[..., Any],
    set_ticks: Callable[..., Any],
) -> None:
    set_scale(axis.scale.value)
    set_label(printable(axis.title))
    if axis.scale is Scale.LOG:
        ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ticks.set_major_formatter(PLAIN)
        ticks.set_minor_formatter(NullFormatter())
    if axis.ticks:
        set_ticks(
            [position for position, _ in axis.ticks], [printable(text) for _, text in axis.ticks]
        )
    if axis.limits is not None:
        set_limits(*axis.limits)


def _element(ax: Any, element: Element, together: Sequence[Bars], order: int) -> Any:
    """Draw an element and return its symbol for the legend."""
    match element:
        case Line():
            style = "steps-post" if element.step else "default"
            (handle,) = ax.plot(
                element.x, element.y, DASHES[element.dash], color=LIGHT[element.color],
                linewidth=element.width, drawstyle=style, zorder=order,
            )  # fmt: skip
            return handle
        case Band():
            return ax.fill_between(
                element.x, element.lower, element.upper, color=LIGHT[element.color], alpha=0.2,
                linewidth=0.0, zorder=order,
            )  # fmt: skip
        case Points():
            return _points(ax, element, order)
        case Bars():
            return _bars(ax, element, together, order)
        case Heatmap():
            return _heatmap(ax, element)
        case Contour():
            return _contour(ax, element, order)
        case Region():
            return _region(ax, element, order)
        case Limit():
            across = ax.axvline if element.vertical else ax.axhline
            return across(
                element.value, color=LIGHT[element.color], linestyle=DASHES[element.dash],
                linewidth=1.3, zorder=order,
            )  # fmt: skip


def _points(ax: Any, points: Points, order: int) -> Any:
    color = LIGHT[points.color]
    if points.low is not None and points.high is not None:
        ax.vlines(points.x, points.low, points.high, color=color, linewidth=1.2, zorder=order)
    style: dict[str, Any] = {
        "marker": MARKERS[points.marker],
        "s": points.size**2 * (1.8 if points.marker is Marker.STAR else 1.0),
        "zorder": order + 0.5,
        "clip_on": False,
    }
    if points.values is not None and points.colors is not None:
        scale = points.colors
        style |= {"c": np.asarray(points.values), "cmap": _colormap(scale), "norm": _norm(scale)}
        if points.marker is not Marker.CROSS:
            style |= {"edgecolors": "#1c232b", "linewidths": 0.5}
    elif points.marker is Marker.CROSS:
        style |= {"c": color, "linewidths": 1.8}
    else:
        edge = LIGHT[Color.PAPER] if points.filled else color
        style |= {"facecolors": color if points.filled else "none", "edgecolors": edge}
    return ax.scatter(points.x, points.y, **style)


def _bars(ax: Any, bars: Bars, together: Sequence[Bars], order: int) -> Any:
    x, width = np.asarray(bars.x, dtype=float), bars.width
    if bars.base is None:
        width = bars.width / len(together)
        # By identity: two series of bars may be equal.
        place = next(k for k, other in enumerate(together) if other is bars)
        x = x + width * (place - (len(together) - 1) / 2.0)
    bottom = 0.0 if bars.base is None else np.asarray(bars.base, dtype=float)
    handle = ax.bar(x, bars.y, width, bottom, color=LIGHT[bars.color], zorder=order)
    if bars.low is not None and bars.high is not None:
        ax.vlines(x, bars.low, bars.high, color=LIGHT[Color.INK], linewidth=1.2, zorder=order + 0.5)
    return handle


def _heatmap(ax: Any, heatmap: Heatmap) -> None:
    ax.pcolormesh(
        _edges(heatmap.x, ax.get_xscale()), _edges(heatmap.y, ax.get_yscale()), heatmap.z,
        cmap=_colormap(heatmap.colors), norm=_norm(heatmap.colors), rasterized=True,
    )  # fmt: skip
    ax.grid(visible=False)


def _edges(centres: Values, scale: str) -> NDArray[np.float64]:
    """Return the cell borders of a heatmap: half-way between the centres on the axis' scale."""
    places = np.asarray(centres, dtype=np.float64)
    places = np.log(places) if scale == Scale.LOG.value else places
    if len(places) < 2:
        edges = places[0] + np.array([-0.5, 0.5])
    else:
        middles = (places[:-1] + places[1:]) / 2.0
        ends = places[[0, -1]] * 2.0 - middles[[0, -1]]
        edges = np.concatenate([ends[:1], middles, ends[1:]])
    edges = np.exp(edges) if scale == Scale.LOG.value else edges
    return np.asarray(edges, dtype=np.float64)


def _contour(ax: Any, contour: Contour, order: int) -> Any:
    color, dash = LIGHT[contour.color], DASHES[contour.dash]
    within = [v for v in contour.levels if np.nanmin(contour.z) < v < np.nanmax(contour.z)]
    if within:
        lines = ax.contour(
            contour.x, contour.y, contour.z, levels=sorted(within), colors=color,
            linestyles=dash, linewidths=contour.width, zorder=order,
        )  # fmt: skip
        if contour.labelled:
            ax.clabel(lines, fontsize=7)
    return mpl.lines.Line2D([], [], color=color, linestyle=dash, linewidth=contour.width)


def _region(ax: Any, region: Region, order: int) -> Any:
    color = LIGHT[region.color]
    if region.hatched:
        lines = hatching(region, *map(Scale, (ax.get_xscale(), ax.get_yscale())))
        # With a halo, which keeps it visible on any colour of a field.
        ax.plot(*lines, "-", color=LIGHT[Color.PAPER], linewidth=2.4, alpha=0.6, zorder=order)
        ax.plot(*lines, "-", color=color, linewidth=0.9, zorder=order)
        return mpl.patches.Patch(facecolor="none", edgecolor=color, hatch="////")
    shade = to_rgba(color, 0.4)
    if np.nanmax(region.z) > region.above:
        ax.contourf(
            region.x, region.y, region.z, levels=[region.above, math.inf], colors=[shade],
            zorder=order,
        )  # fmt: skip
    return mpl.patches.Patch(facecolor=shade)


def _colormap(scale: ColorScale) -> LinearSegmentedColormap:
    stops = SEQUENTIAL if scale.middle is None else DIVERGING
    return LinearSegmentedColormap.from_list("scale", list(stops))


def _norm(scale: ColorScale) -> Normalize:
    if scale.middle is not None:
        return TwoSlopeNorm(scale.middle, scale.low, scale.high)
    kind = LogNorm if scale.scale is Scale.LOG else Normalize
    return kind(scale.low, scale.high)


def _mappable(scale: ColorScale) -> mpl.cm.ScalarMappable:
    return mpl.cm.ScalarMappable(_norm(scale), _colormap(scale))
