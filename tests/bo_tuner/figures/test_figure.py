"""Descriptions of figures refuse what no renderer could draw."""

import numpy as np
import pytest

from bo_tuner.figures.figure import (
    Axis,
    Band,
    Bars,
    ColorScale,
    Contour,
    Figure,
    Heatmap,
    Line,
    Panel,
    Points,
    Region,
    Scale,
)

SCALE = ColorScale(label="z", low=0.0, high=1.0)
PANEL = Panel(x=Axis(label="x"), y=Axis(label="y"), elements=[])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Line(x=[1, 2], y=[1]), "Line: expected 2 values in y"),
        (lambda: Line(x=[1, 2], y=[1, 2], hover=["a"]), "Line: expected 2 values in hover"),
        (lambda: Band(x=[1, 2], lower=[1, 2], upper=[1]), "Band: expected 2 values in upper"),
        (lambda: Points(x=[1], y=[1], values=[1]), "values need colors"),
        (lambda: Points(x=[1], y=[1], low=[0]), "error bars need low and high"),
        (lambda: Bars(x=[1], y=[1], high=[2]), "error bars need low and high"),
        (lambda: Bars(x=[1], y=[1], base=[0, 0]), "Bars: expected 1 values in base"),
    ],
)
def test_series_have_one_length(make, said):
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda z: Heatmap(x=[1, 2], y=[1, 2, 3], z=z, colors=SCALE),
        lambda z: Contour(x=[1, 2], y=[1, 2, 3], z=z, levels=[0.5]),
        lambda z: Region(x=[1, 2], y=[1, 2, 3], z=z, above=0.5),
    ],
)
def test_a_field_has_a_row_for_each_y(make):
    make(np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"expected z of shape \(3, 2\), found \(2, 3\)"):
        make(np.zeros((2, 3)))


@pytest.mark.parametrize(
    "values",
    [
        {"low": 1.0, "high": 1.0},
        {"low": 0.0, "high": float("nan")},
        {"low": 0.0, "high": 1.0, "middle": 1.0},
        {"low": 0.0, "high": 1.0, "scale": Scale.LOG},
    ],
)
def test_a_color_scale_has_a_range(values):
    with pytest.raises(ValueError, match="colours"):
        ColorScale(label="z", **values)


@pytest.mark.parametrize("name", ["", "../up", "Big", "a b"])
def test_the_name_of_a_figure_is_one_of_a_file(name):
    with pytest.raises(ValueError, match="name: expected lower-case letters"):
        Figure(name=name, title="", caption="", alternative="", panels=[PANEL])


def test_a_figure_has_panels():
    with pytest.raises(ValueError, match="at least one panel"):
        Figure(name="a", title="", caption="", alternative="", panels=[])


def test_panels_fill_rows():
    figure = Figure(name="a", title="", caption="", alternative="", panels=[PANEL] * 5, columns=2)
    assert figure.rows == 3


def test_an_axis_shows_its_unit():
    assert Axis(label="speed", unit="m/s").title == "speed [m/s]"
    assert Axis(label="weight").title == "weight"
