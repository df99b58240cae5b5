"""Pictures of panels: well-formed, with every element where its data are."""

import base64
import re
import struct
import zlib
from xml.etree import ElementTree

import numpy as np
import pytest

from bo_tuner.figures.figure import (
    Axis,
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
from bo_tuner.figures.svg_renderer import BOTTOM, LEFT, RIGHT, TOP, panel_svg, ticks

WIDTH, HEIGHT = 500, 300
ACROSS, UP = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM


def drawn(*elements, x=(0.0, 10.0), y=(0.0, 1.0), scale=Scale.LINEAR):
    """The inner picture, whose origin is the upper left corner of the axes."""
    panel = Panel(
        x=Axis(label="x", limits=x, scale=scale), y=Axis(label="y", limits=y), elements=elements
    )
    return ElementTree.fromstring(panel_svg(panel, WIDTH, HEIGHT)).find("svg")


def places(path):
    return [tuple(map(float, pair.split(","))) for pair in re.findall(r"[-\d.]+,[-\d.]+", path)]


def test_every_element_makes_a_well_formed_picture(full_figure):
    for panel in full_figure.panels:
        root = ElementTree.fromstring(panel_svg(panel, WIDTH, HEIGHT))
        assert len(root.find("svg")) >= len(panel.elements)
        assert not re.search("nan|inf", ElementTree.tostring(root, encoding="unicode"))
    first = panel_svg(full_figure.panels[0], WIDTH, HEIGHT)
    assert "fields, $a_1$ &amp; &lt;b&gt;" in first


def test_points_and_lines_are_where_the_data_are():
    inner = drawn(Line(x=[0.0, 5.0, 7.0, 10.0], y=[0.0, 0.5, np.nan, 1.0]))
    assert places(inner.find("path").get("d")) == [
        (0.0, UP),
        (ACROSS / 2, UP / 2),
        (ACROSS, 0.0),
    ]
    # A gap where there is no value.
    assert inner.find("path").get("d").count("M") == 2
    inner = drawn(Points(x=[1.0, 100.0], y=[0.25, 0.25]), x=(1.0, 100.0), scale=Scale.LOG)
    found = [places(p.get("transform"))[0] for p in inner.findall("path")]
    assert found == [(0.0, 0.75 * UP), (ACROSS, 0.75 * UP)]


def test_a_limit_crosses_the_panel():
    up, across = drawn(Limit(value=2.5, vertical=True), Limit(value=0.25)).findall("path")
    assert up.get("d").startswith(f"M{ACROSS / 4:.1f},0V")
    assert across.get("d").startswith(f"M0,{0.75 * UP:.1f}H")


def test_a_field_is_a_picture_with_a_pixel_for_each_value():
    colors = ColorScale(label="z", low=0.0, high=1.0)
    z = np.array([[0.0, 1.0, np.nan], [1.0, 0.0, 0.0]])
    image = drawn(Heatmap(x=[0.0, 5.0, 10.0], y=[0.25, 0.75], z=z, colors=colors)).find("image")
    data = base64.b64decode(image.get("href").removeprefix("data:image/png;base64,"))
    width, height = struct.unpack(">II", data[16:24])
    length = struct.unpack(">I", data[33:37])[0]
    rows = zlib.decompress(data[41 : 41 + length])
    assert (width, height) == (3, 2)
    low, high = (bytes.fromhex(stops(colors)[k][1][1:]) + b"\xff" for k in (0, -1))
    # The upper row comes first, and what is not known is transparent.
    assert rows == b"\0" + high + low + low + b"\0" + low + high + bytes(4)
    # Cells are centred at their values.
    assert float(image.get("x")) == pytest.approx(-ACROSS / 4, abs=0.1)
    assert float(image.get("height")) == pytest.approx(UP, abs=0.2)


def test_a_contour_is_where_the_field_has_its_level():
    """Of the field x it is a straight line, between the columns of the grid as well."""
    x, y = np.linspace(0.0, 10.0, 6), np.linspace(0.0, 1.0, 4)
    z = np.tile(x, (4, 1))
    (path,) = drawn(Contour(x=x, y=y, z=z, levels=[3.3])).findall("path")
    found = places(path.get("d"))
    assert len(found) == 6
    assert {a for a, _ in found} == {round(0.33 * ACROSS, 1)}


@pytest.mark.parametrize(
    ("low", "high", "scale", "texts"),
    [
        (0.0, 1.0, Scale.LINEAR, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-3.0, 12.0, Scale.LINEAR, ["0", "5", "10"]),
        (0.05, 200.0, Scale.LOG, ["0.1", "1", "10", "100"]),
        (2.0, 5.0, Scale.LOG, ["2", "2.5", "3", "3.5", "4", "4.5", "5"]),
    ],
)
def test_ticks_are_round_numbers(low, high, scale, texts):
    assert [text for _, text in ticks(Axis(label="x", scale=scale), low, high)] == texts
