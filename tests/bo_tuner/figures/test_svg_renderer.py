"""Pictures of panels: well-formed, with every element where its data are."""

import base64
import dataclasses
import re
import struct
import zlib
from xml.etree import ElementTree

import numpy as np
import pytest

from bo_tuner.figures.figure import (
    Axis,
    Bars,
    ColorScale,
    Contour,
    Heatmap,
    Limit,
    Line,
    Panel,
    Points,
    Scale,
)
from bo_tuner.figures.keys import stops
from bo_tuner.figures.svg_renderer import SIDE, hover_texts, panel_svg, panels_svg, symbols, ticks

HEIGHT = 300


def drawn(*elements, x=(0.0, 10.0), y=(0.0, 1.0), scale=Scale.LINEAR):
    """The groups of the elements, and what they have stretched over the axes."""
    panel = Panel(
        x=Axis(label="x", limits=x, scale=scale), y=Axis(label="y", limits=y), elements=elements
    )
    groups = ElementTree.fromstring(panel_svg(panel, HEIGHT)).findall("g[@data-name]")
    assert len(groups) == len(elements)
    return [group.find("svg") if group.find("svg") is not None else group for group in groups]


def marked(group):
    """Where the marks of points are, in percent of the axes."""
    return [
        tuple(float(use.get(name).removesuffix("%")) for name in "xy") for use in group.iter("use")
    ]


def places(path):
    return [tuple(map(float, pair.split(","))) for pair in re.findall(r"[-\d.]+,[-\d.]+", path)]


def test_every_element_makes_a_well_formed_picture(full_figure):
    pictures = panels_svg(full_figure)
    for panel, picture in zip(full_figure.panels, pictures, strict=True):
        root = ElementTree.fromstring(picture)
        groups = root.findall("g[@data-name]")
        assert [g.get("data-name") for g in groups] == [
            getattr(element, "name", "") for element in panel.elements
        ]
        assert all(len(group) for group in groups)
        assert not re.search("nan|inf", ElementTree.tostring(root, encoding="unicode"))
    assert "fields, $a_1$ &amp; &lt;b&gt;" in pictures[0]
    used = {use for picture in pictures for use in re.findall('href="#([^"]+)"', picture)}
    assert used <= set(re.findall('id="([^"]+)"', symbols()))


def test_points_and_lines_are_where_the_data_are():
    (inner,) = drawn(Line(x=[0.0, 5.0, 7.0, 10.0], y=[0.0, 0.5, np.nan, 1.0]))
    path = inner.find("path").get("d")
    assert places(path) == [(0.0, SIDE), (SIDE / 2, SIDE / 2), (SIDE, 0.0)]
    # A gap where there is no value.
    assert path.count("M") == 2
    (inner,) = drawn(Line(x=[0.0, 5.0], y=[0.0, 1.0], step=True))
    assert places(inner.find("path").get("d")) == [(0.0, SIDE), (SIDE / 2, SIDE), (SIDE / 2, 0.0)]
    (group,) = drawn(
        Points(x=[1.0, 10.0, 100.0], y=[0.25, 0.5, 0.25]), x=(1.0, 100.0), scale=Scale.LOG
    )
    assert marked(group) == [(0.0, 75.0), (50.0, 50.0), (100.0, 75.0)]
    # A point beyond the ends of an axis is not beside it.
    (group,) = drawn(Points(x=[-1.0, 3.0, 3.0], y=[0.5, 1.5, 0.5]))
    assert marked(group) == [(30.0, 50.0)]


def test_points_have_texts_and_trials(full_figure):
    """Panels of a figure show the same trials, whose texts stand there once."""
    points = Points(x=[1.0, 2.0], y=[1.0, 2.0], hover=["one <b>", "two\nlines"], trials=[7, 9])
    step = Line(x=[1.0, 2.0], y=[1.0, 2.0], hover=["two\nlines", "three"], step=True)
    panel = Panel(x=Axis(label="x"), y=Axis(label="y"), elements=[points, step])
    figure = dataclasses.replace(full_figure, panels=[panel, panel])
    texts = hover_texts(figure)
    assert texts == ["one <b>", "two\nlines", "three"]
    for picture in panels_svg(figure):
        uses = list(ElementTree.fromstring(picture).iter("use"))
        assert [texts[int(use.get("data-tip"))] for use in uses] == [*points.hover, *step.hover]
        assert [use.get("data-trial") for use in uses] == ["7", "9", None, None]


def test_a_mark_on_a_field_stands_in_two_rings():
    field = Heatmap(
        x=[0.0, 10.0], y=[0.0, 1.0], z=np.zeros((2, 2)), colors=ColorScale(label="z", low=0, high=1)
    )
    alone, on_field = (
        drawn(*elements, Points(x=[5.0], y=[0.5]))[-1].findall("g") for elements in ([], [field])
    )
    assert [len(alone), len(on_field)] == [1, 3]
    strokes = [group.get("stroke") for group in on_field]
    assert strokes == ["var(--black)", "var(--white)", "var(--paper)"]
    widths = [float(group.get("stroke-width")) for group in on_field]
    assert widths == sorted(widths, reverse=True)


def test_a_bar_is_where_its_data_are_and_tells_of_them():
    (inner,) = drawn(Bars(x=[2.0], y=[0.4], base=[0.1], width=1.0, name="count"))
    (bar,) = inner.findall("rect")
    found = [float(bar.get(name)) for name in ("x", "y", "width", "height")]
    assert found == pytest.approx([0.15 * SIDE, 0.5 * SIDE, 0.1 * SIDE, 0.4 * SIDE])
    assert bar.find("title").text == "count 0.4"


def test_a_limit_crosses_the_panel():
    up, across = drawn(Limit(value=2.5, vertical=True), Limit(value=0.25))
    assert up.find("path").get("d") == f"M{SIDE / 4:.1f},0V{SIDE}"
    assert across.find("path").get("d") == f"M0,{0.75 * SIDE:.1f}H{SIDE}"


def test_a_field_is_a_picture_with_a_pixel_for_each_value():
    colors = ColorScale(label="z", low=0.0, high=1.0)
    z = np.array([[0.0, 1.0, np.nan], [1.0, 0.0, 0.0]])
    (inner,) = drawn(Heatmap(x=[0.0, 5.0, 10.0], y=[0.25, 0.75], z=z, colors=colors))
    image = inner.find("image")
    data = base64.b64decode(image.get("href").removeprefix("data:image/png;base64,"))
    width, height = struct.unpack(">II", data[16:24])
    length = struct.unpack(">I", data[33:37])[0]
    rows = zlib.decompress(data[41 : 41 + length])
    assert (width, height) == (3, 2)
    low, high = (bytes.fromhex(stops(colors)[k][1][1:]) + b"\xff" for k in (0, -1))
    # The upper row comes first, and what is not known is transparent.
    assert rows == b"\0" + high + low + low + b"\0" + low + high + bytes(4)
    # Cells are centred at their values.
    assert float(image.get("x")) == pytest.approx(-SIDE / 4, abs=0.1)
    assert float(image.get("height")) == pytest.approx(SIDE, abs=0.2)
    # The script tells of them.
    assert image.get("data-values") == "0,1,;1,0,0"
    assert image.get("data-places") == "0.0,500.0,1000.0;750.0,250.0"


def test_a_field_of_integers_on_a_log_axis_has_cells_of_different_widths():
    colors = ColorScale(label="z", low=0.0, high=1.0)
    x, z = [1.0, 2.0, 4.0, 5.0], np.array([[0.0, 1.0, 0.0, 1.0]] * 2)
    (inner,) = drawn(Heatmap(x=x, y=[0.0, 1.0], z=z, colors=colors), x=(1.0, 5.0), scale=Scale.LOG)
    data = base64.b64decode(inner.find("image").get("href").partition(",")[2])
    width = struct.unpack(">I", data[16:20])[0]
    row = zlib.decompress(data[41 : 41 + struct.unpack(">I", data[33:37])[0]])[1 : 1 + 4 * width]
    dark = [row[4 * k : 4 * k + 4] == row[:4] for k in range(width)]
    ends = np.flatnonzero(np.diff(dark)) + 1
    log = np.log(x)
    middles = (log[:-1] + log[1:]) / 2.0
    low, high = 2 * log[0] - middles[0], 2 * log[-1] - middles[-1]
    assert ends / width == pytest.approx((middles - low) / (high - low), abs=1.0 / width)


def test_a_contour_is_where_the_field_has_its_level():
    """Of the field x it is a straight line, between the columns of the grid as well."""
    x, y = np.linspace(0.0, 10.0, 6), np.linspace(0.0, 1.0, 4)
    z = np.tile(x, (4, 1))
    (inner,) = drawn(Contour(x=x, y=y, z=z, levels=[3.3]))
    (path,) = inner.findall("path")
    found = places(path.get("d"))
    assert len(found) == 6
    assert {a for a, _ in found} == {round(0.33 * SIDE, 1)}


@pytest.mark.parametrize(
    ("low", "high", "scale", "texts"),
    [
        (0.0, 1.0, Scale.LINEAR, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-3.0, 12.0, Scale.LINEAR, ["0", "5", "10"]),
        (0.05, 200.0, Scale.LOG, ["0.1", "1", "10", "100"]),
        (2.0, 60.0, Scale.LOG, ["2", "5", "10", "20", "50"]),
        (2.0, 5.0, Scale.LOG, ["2", "2.5", "3", "3.5", "4", "4.5", "5"]),
    ],
)
def test_ticks_are_round_numbers(low, high, scale, texts):
    assert [text for _, text in ticks(Axis(label="x", scale=scale), low, high)] == texts
