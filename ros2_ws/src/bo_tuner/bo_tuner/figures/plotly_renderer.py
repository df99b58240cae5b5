"""Figures as data for Plotly, which draws them in a browser.

A panel becomes a Plotly figure of its own, so that a page can put panels beside or below one
another as its width permits. Colours stay names with an ``@`` in front, such as ``@blue``, or
``@blue/0.2`` with an opacity; the page puts in the shades of its palette, and does so again when
the reader changes between light and dark. Legends and colour bars are the page's, see `keys`:
they belong to all panels of a figure.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bo_tuner.figures.figure import Axis, Bars, Figure, Limit, Panel, Scale
from bo_tuner.figures.plotly_traces import DASHES, Trace, text_of, traces

CHARACTER = 7.0
"""Mean width of a character [px]."""

LONG = 80
"""Tick labels with more characters in total do not fit side by side."""

LITTLE, MUCH = 5.0, 100.0
"""Ratios of the ends of a logarithmic axis: steps of 1, 2, 5 are too wide below, too many above."""

MARGINS = 78
"""Margins above and below a panel [px]."""


def figure_data(figure: Figure) -> dict[str, Any]:
    """Return all panels of a figure for its page, ready for JSON.

    Returns
    -------
    dict
        ``panels`` are those of `panel_data`, but ``hovertext`` has places in the list ``texts``:
        the panels of a figure show the same trials, and these texts are most of a long run's page.
    """
    panels = [panel_data(panel, figure.panel_height) for panel in figure.panels]
    places: dict[str, int] = {}
    for trace in (trace for panel in panels for trace in panel["data"] if "hovertext" in trace):
        trace["hovertext"] = [places.setdefault(text, len(places)) for text in trace["hovertext"]]
    return {"texts": list(places), "panels": panels}


def panel_data(panel: Panel, height: int) -> dict[str, Any]:
    """Return ``data`` and ``layout`` of a panel for Plotly, ready for JSON."""
    drawn: list[Trace] = []
    shapes: list[dict[str, Any]] = []
    beside = any(isinstance(e, Bars) and e.base is None for e in panel.elements)
    for element in panel.elements:
        if isinstance(element, Limit):
            shapes.append(_limit(element))
        else:
            drawn += traces(element)
    layout: dict[str, Any] = {
        "height": height,
        "margin": {"l": 52, "r": 12, "t": 34, "b": 44},
        "paper_bgcolor": "@none",
        "plot_bgcolor": "@none",
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "@ink"},
        "hoverlabel": {"align": "left", "namelength": 40},
        "hovermode": "closest",
        "showlegend": False,
        "barmode": "group" if beside else "overlay",
        "bargap": 0.2,
        "dragmode": "zoom",
        "shapes": shapes,
        "xaxis": _axis(panel.x, _values(drawn, shapes, "x"))
        | {"title": {"text": text_of(panel.x.title), "standoff": 4}},
        "yaxis": _axis(panel.y, _values(drawn, shapes, "y")),
    }
    title, label = text_of(panel.title), text_of(panel.y.title)
    if len(panel.y.title) * CHARACTER > height - MARGINS:
        # In such a low panel the label of the y axis would be cropped.
        title, label = ": ".join(part for part in (title, label) if part), ""
    layout["title"] = {"text": title, "x": 0.01, "y": 0.98, "yanchor": "top", "font": {"size": 12}}
    layout["yaxis"]["title"] = {"text": label, "standoff": 4}
    return {"data": drawn, "layout": layout}


def _values(
    drawn: Sequence[Trace], shapes: Sequence[Mapping[str, Any]], letter: str
) -> list[float]:
    """Return all that an axis shows."""
    values = [v for trace in drawn for v in trace.get(letter, ()) if v is not None]
    return values + [
        shape[f"{letter}0"] for shape in shapes if shape.get(f"{letter}ref") != "paper"
    ]


def _axis(axis: Axis, shown: Sequence[float]) -> dict[str, Any]:
    layout: dict[str, Any] = {
        "type": axis.scale.value,
        "automargin": True,
        "gridcolor": "@grid",
        "linecolor": "@gray",
        "zeroline": False,
        "hoverformat": ".4g",
    }
    if axis.scale is Scale.LOG:
        layout["tickformat"] = "~g"
        seen = shown if axis.limits is None else axis.limits
        if seen and max(seen) > MUCH * min(seen):
            # Only 1 of each decade: with 2 and 5 the numbers would run into each other.
            layout["dtick"] = 1
        elif not seen or max(seen) > LITTLE * min(seen):
            # 1, 2 and 5 of each decade, in full. On a shorter axis fewer than two of them would be
            # seen; there Plotly's own choice is that of a linear axis.
            layout["dtick"] = "D2"
    if axis.limits is not None:
        ends = [math.log10(v) if axis.scale is Scale.LOG else v for v in axis.limits]
        layout["range"] = ends
    if axis.ticks:
        layout["tickvals"] = [position for position, _ in axis.ticks]
        layout["ticktext"] = [text_of(text) for _, text in axis.ticks]
        if sum(len(text) for _, text in axis.ticks) > LONG:
            layout["tickangle"] = -30
    return layout


def _limit(limit: Limit) -> dict[str, Any]:
    along, across = ("y", "x") if limit.vertical else ("x", "y")
    return {
        "type": "line",
        "name": text_of(limit.name),
        f"{along}ref": "paper",
        f"{along}0": 0,
        f"{along}1": 1,
        f"{across}0": limit.value,
        f"{across}1": limit.value,
        "line": {"color": f"@{limit.color}", "dash": DASHES[limit.dash], "width": 1.6},
    }
