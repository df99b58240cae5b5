"""Figures for the browser: what Plotly itself takes, with the data unchanged."""

import json
import math
import re

import numpy as np
import plotly.graph_objects as go
import pytest

from bo_tuner.figures.figure import (
    Axis,
    Color,
    ColorScale,
    Figure,
    Heatmap,
    Limit,
    Line,
    Panel,
    Points,
    Scale,
)
from bo_tuner.figures.keys import color_bars, legend
from bo_tuner.figures.palette import DARK, DIVERGING, LIGHT
from bo_tuner.figures.plotly_renderer import figure_data, panel_data


def panel_of(*elements):
    return Panel(x=Axis(label="x"), y=Axis(label="y"), elements=elements)


def resolve(data, shades):
    """Replace the names of colours by the shades of a palette, as the page does."""

    def shade(match):
        name, opacity = match.groups()
        if name == "none":
            return '"rgba(0,0,0,0)"'
        color = shades[Color.GRAY if name == "grid" else Color(name)]
        red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
        return f'"rgba({red},{green},{blue},{opacity or (0.25 if name == "grid" else 1)})"'

    text = re.sub(r'"@([a-z]+)(?:/([0-9.]+))?"', shade, json.dumps(data))
    return json.loads(text)


@pytest.mark.parametrize("palette", [LIGHT, DARK])
def test_plotly_takes_every_element(full_figure, palette):
    for panel in full_figure.panels:
        # Plotly refuses what is not in its schema.
        figure = go.Figure(resolve(panel_data(panel, 300), palette))
        assert len(figure.data) == len(panel_data(panel, 300)["data"])
    kinds = {t["type"] for p in full_figure.panels for t in panel_data(p, 300)["data"]}
    assert kinds == {"scatter", "bar", "heatmap", "contour"}


def test_no_name_of_a_color_is_left(full_figure):
    for panel in full_figure.panels:
        assert '"@' in json.dumps(panel_data(panel, 300))
        assert '"@' not in json.dumps(resolve(panel_data(panel, 300), LIGHT))


def test_the_data_stay_what_they_are():
    y = [1.0, math.nan, 1e-9, -123456.0]
    (trace,) = panel_data(panel_of(Line(x=[1, 2, 3, 4], y=y)), 300)["data"]
    assert trace["x"] == [1.0, 2.0, 3.0, 4.0]
    # JSON has no NaN; null is a gap, too.
    assert trace["y"] == [1.0, None, 1e-9, -123456.0]
    z = np.array([[1.0, 2.0], [3.0, math.nan], [5.0, 6.0]])
    colors = ColorScale(label="z", low=1.0, high=6.0)
    (trace,) = panel_data(panel_of(Heatmap(x=[1, 2], y=[1, 2, 3], z=z, colors=colors)), 300)["data"]
    assert trace["z"] == [[1.0, 2.0], [3.0, None], [5.0, 6.0]]


def test_points_that_are_trials_lead_to_them():
    """A page asks a point that is clicked for its number; other points have none."""
    points = Points(x=[1.0, 2.0], y=[3.0, 4.0], trials=[7, 12])
    line = Line(x=[1.0, 2.0], y=[3.0, 4.0])
    of_points, of_line = panel_data(panel_of(points, line), 300)["data"]
    assert of_points["customdata"] == [7, 12]
    assert "customdata" not in of_line
    with pytest.raises(ValueError, match="expected 2 values in trials as in x, found 1"):
        Points(x=[1.0, 2.0], y=[3.0, 4.0], trials=[7])


def test_texts_are_no_markup():
    line = Line(x=[1], y=[1], name="<b>a</b> & b", hover=["<i>one</i>\ntwo"])
    data = panel_data(panel_of(line, Limit(value=1.0, name="<u>")), 300)
    (trace,) = data["data"]
    assert trace["name"] == "&lt;b&gt;a&lt;/b&gt; &amp; b"
    assert trace["hovertext"] == ["&lt;i&gt;one&lt;/i&gt;<br>two"]
    assert data["layout"]["shapes"][0]["name"] == "&lt;u&gt;"


def test_panels_share_the_texts_of_a_figure():
    points = [Points(x=[0.0, 1.0], y=[2.0, 3.0], hover=hover) for hover in (["a", "b"], ["b", "c"])]
    bare = Points(x=[0.0], y=[2.0])
    figure = Figure(
        name="f",
        title="F",
        caption="",
        alternative="",
        panels=[panel_of(points[0]), panel_of(bare, points[1])],
    )
    data = figure_data(figure)
    assert data["texts"] == ["a", "b", "c"]
    (first,), (none, second) = (panel["data"] for panel in data["panels"])
    assert (first["hovertext"], second["hovertext"]) == ([0, 1], [1, 2])
    assert "hovertext" not in none


def test_error_bars_end_where_they_should():
    points = Points(x=[0.0], y=[2.0], low=[0.5], high=[2.25])
    (trace,) = panel_data(panel_of(points), 300)["data"]
    assert trace["error_y"]["array"] == [0.25]
    assert trace["error_y"]["arrayminus"] == [1.5]


def test_limits_on_a_log_axis_are_its_exponents():
    panel = Panel(
        x=Axis(label="x", scale=Scale.LOG, limits=(1.0, 100.0)),
        y=Axis(label="y", limits=(1.0, 100.0)),
        elements=[],
    )
    layout = panel_data(panel, 300)["layout"]
    assert layout["xaxis"]["range"] == [0.0, 2.0]
    assert layout["yaxis"]["range"] == [1.0, 100.0]


@pytest.mark.parametrize(("low", "dtick"), [(0.14, None), (0.01, "D2"), (0.001, 1)])
def test_a_log_axis_has_ticks_however_little_it_shows(low, dtick):
    """Steps of 1, 2, 5 leave one tick or none between 0.14 and 0.25."""
    axis = Axis(label="y", scale=Scale.LOG)
    line = Line(x=[1, 2, 3], y=[low, math.nan, 0.25])
    layout = panel_data(Panel(x=Axis(label="x"), y=axis, elements=[line]), 300)["layout"]
    assert layout["yaxis"].get("dtick") == dtick


def stops_of(scale):
    points = Points(x=[0], y=[0], values=[scale.low], colors=scale)
    (trace,) = panel_data(panel_of(points), 300)["data"]
    return dict(trace["marker"]["colorscale"])


def test_the_middle_of_the_colors_is_at_the_limit():
    stops = stops_of(ColorScale(label="z", low=0.0, high=4.0, middle=1.0))
    # Colours are placed by value, from 0 at the low end to 1 at the high one.
    assert stops[0.25] == DIVERGING[2][1]
    assert stops[0.0] == DIVERGING[0][1]
    assert stops[1.0] == DIVERGING[-1][1]


def test_log_colors_are_half_way_at_the_geometric_mean():
    stops = stops_of(ColorScale(label="z", low=1.0, high=9.0, scale=Scale.LOG))
    half = stops_of(ColorScale(label="z", low=0.0, high=1.0))[0.5]
    # The geometric mean of 1 and 9 is 3, a quarter of the way from 1 to 9.
    assert stops[0.25] == half


def test_the_bar_of_a_scale_has_its_ends_and_its_limit():
    scale = ColorScale(label="peak", unit="m/s", low=0.0, high=4.0, middle=1.0)
    points = Points(x=[0], y=[0], values=[1.0], colors=scale)
    figure = Figure(name="a", title="", caption="", alternative="", panels=[panel_of(points)] * 2)
    (bar,) = color_bars(figure)
    assert bar.title == "peak [m/s]"
    assert list(bar.ticks) == [(0.0, "0"), (0.5, "1"), (1.0, "4")]


def test_the_legend_names_each_element_once(full_figure):
    entries = legend(full_figure)
    names = [entry.name for entry in entries]
    assert names == ["out", "edge", "cut", "band", "line", "points", "limit", "here", "a", "b"]
    kinds = {entry.name: entry.kind for entry in entries}
    assert (kinds["line"], kinds["out"], kinds["points"]) == ("line", "hatched", "cross")
