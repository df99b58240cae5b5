"""A figure with one of each element."""

import numpy as np
import pytest

from bo_tuner.figures.figure import (
    Axis,
    Band,
    Bars,
    Color,
    ColorScale,
    Contour,
    Dash,
    Figure,
    Heatmap,
    Limit,
    Line,
    Marker,
    Panel,
    Points,
    Region,
    Scale,
)


@pytest.fixture(scope="session")
def full_figure():
    x, y = np.array([1.0, 2.0, 4.0]), np.array([-1.0, 0.0])
    z = np.array([[1.0, 2.0, 3.0], [2.0, np.nan, 10.0]])
    by_value = ColorScale(label="error", unit="m/s", low=1.0, high=10.0, scale=Scale.LOG)
    by_limit = ColorScale(label="peak", low=0.0, high=2.0, middle=0.5)
    fields = Panel(
        title="fields, $a_1$ & <b>",
        x=Axis(label="horizon", unit="samples", scale=Scale.LOG, limits=(1.0, 4.0)),
        y=Axis(label="weight"),
        elements=[
            Heatmap(x=x, y=y, z=z, colors=by_value),
            Region(x=x, y=y, z=z, above=2.5, name="out"),
            Contour(x=x, y=y, z=z, levels=[1.5, 2.5], name="edge", dash=Dash.DOTTED),
            Points(x=[1.0, 2.0], y=[0.0, -1.0], values=[0.2, 1.5], colors=by_limit, name="cut"),
        ],
    )
    series = Panel(
        x=Axis(label="time", unit="s"),
        y=Axis(label="speed", unit="m/s", scale=Scale.LOG),
        elements=[
            Band(x=x, lower=x, upper=2.0 * x, name="band"),
            Line(x=x, y=[1.0, np.nan, 3.0], name="line", step=True, hover=["a", "b\nc", "d"]),
            Points(x=x, y=x, low=x / 2, high=2 * x, marker=Marker.CROSS, name="points"),
            Points(x=x, y=x, marker=Marker.STAR, filled=False),
            Limit(value=2.0, name="limit"),
            Limit(value=3.0, vertical=True, color=Color.GREEN, name="here"),
        ],
    )
    bars = Panel(
        x=Axis(label="", ticks=[(0.0, "one"), (1.0, "two")]),
        y=Axis(label="count"),
        elements=[
            Bars(x=[0.0, 1.0], y=[2.0, 3.0], name="a", low=[1.0, 2.0], high=[3.0, 4.0]),
            Bars(x=[0.0, 1.0], y=[1.0, 2.0], name="b", color=Color.ORANGE),
        ],
    )
    return Figure(
        name="full",
        title="Everything at once",
        caption="One of each.",
        alternative="A test figure.",
        panels=[fields, series, bars],
        columns=2,
    )
