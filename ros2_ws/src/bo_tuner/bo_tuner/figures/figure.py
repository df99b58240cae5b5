"""The description of a figure, independent of the plotting libraries.

A `Figure` is a grid of panels; a panel has two axes and elements in drawing order. The renderers
turn a figure into a PNG or SVG file (`matplotlib_renderer`) or into an interactive part of a page
(`svg_renderer`). Colours are names, for which each renderer has shades that are readable on
light and dark backgrounds. They can be distinguished with red-green colour blindness, and series
of different colours also have different markers or dashes.

Series (n,) are sequences or arrays of floats; NaN leaves a gap. Grids z (rows, columns) have a
row for each y and a column for each x.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from bo_tuner.text import with_unit

OPTIONAL = ("hover", "trials")
"""Series of an element that may be empty."""

Values = Sequence[float] | NDArray[np.float64]
Grid = NDArray[np.float64]


class Color(StrEnum):
    """Colours by name, after Okabe and Ito (2008), "Color Universal Design".

    Ink is the text colour, paper the background. Black and white are the same on light and dark
    backgrounds, for elements on a heatmap, whose colours are the same as well.
    """

    BLUE = "blue"
    ORANGE = "orange"
    GREEN = "green"
    VERMILION = "vermilion"
    PURPLE = "purple"
    SKY = "sky"
    GRAY = "gray"
    INK = "ink"
    PAPER = "paper"
    BLACK = "black"
    WHITE = "white"


class Marker(StrEnum):
    """Shapes of points."""

    CIRCLE = "circle"
    SQUARE = "square"
    DIAMOND = "diamond"
    TRIANGLE = "triangle"
    CROSS = "cross"
    STAR = "star"


class Dash(StrEnum):
    """Kinds of lines."""

    SOLID = "solid"
    DASHED = "dashed"
    DOTTED = "dotted"
    DASH_DOT = "dash-dot"


class Scale(StrEnum):
    """Scale of an axis or of colours."""

    LINEAR = "linear"
    LOG = "log"


@dataclass(frozen=True, kw_only=True)
class ColorScale:
    """A colour scale with its colour bar.

    Attributes
    ----------
    label, unit
        Title of the colour bar, shown as ``label [unit]``.
    low, high
        Values at the ends; values beyond have the colour of the end.
    middle
        Centre of a diverging scale from blue to red, such as a limit; without it the scale is
        sequential, from dark to bright.
    scale
        Linear or logarithmic; with a `middle`, linear.
    """

    label: str
    low: float
    high: float
    unit: str = ""
    middle: float | None = None
    scale: Scale = Scale.LINEAR

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"colours need low < high, found {self.low} and {self.high}")
        if self.middle is not None and not self.low < self.middle < self.high:
            raise ValueError(f"colours: {self.middle} is not between {self.low} and {self.high}")
        if self.scale is Scale.LOG and self.low <= 0.0:
            raise ValueError(f"colours on a log scale need positive ends, found {self.low}")

    @property
    def title(self) -> str:
        """The label with its unit in brackets."""
        return with_unit(self.label, self.unit)


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line through the points x (n,), y (n,); as steps if `step`.

    `name` is its entry in the legend, `hover` (n,) the tooltip of each point, and `trials` (n,) the
    number of the trial that a point is.
    """

    x: Values
    y: Values
    name: str = ""
    color: Color = Color.BLUE
    dash: Dash = Dash.SOLID
    width: float = 2.0
    step: bool = False
    hover: Sequence[str] = ()
    trials: Sequence[int] = ()

    def __post_init__(self) -> None:
        _same_length(self, len(self.x), y=self.y, hover=self.hover, trials=self.trials)


@dataclass(frozen=True, kw_only=True)
class Band:
    """The area between `lower` (n,) and `upper` (n,) over x (n,)."""

    x: Values
    lower: Values
    upper: Values
    name: str = ""
    color: Color = Color.BLUE

    def __post_init__(self) -> None:
        _same_length(self, len(self.x), lower=self.lower, upper=self.upper)


@dataclass(frozen=True, kw_only=True)
class Points:
    """Points x (n,), y (n,).

    Attributes
    ----------
    name
        Entry in the legend.
    color, marker, size, filled
        Style; the size is a diameter [pt].
    values, colors
        Values (n,) shown by the colour scale `colors` instead of `color`.
    low, high
        Ends (n,) of vertical error bars, in the axis' unit.
    hover
        Tooltips (n,).
    trials
        Numbers (n,) of the trials that the points are.
    """

    x: Values
    y: Values
    name: str = ""
    color: Color = Color.BLUE
    marker: Marker = Marker.CIRCLE
    size: float = 7.0
    filled: bool = True
    values: Values | None = None
    colors: ColorScale | None = None
    low: Values | None = None
    high: Values | None = None
    hover: Sequence[str] = ()
    trials: Sequence[int] = ()

    def __post_init__(self) -> None:
        """Check the lengths, and that values come with colours and error bars with both ends."""
        _same_length(
            self,
            len(self.x),
            y=self.y,
            values=self.values,
            low=self.low,
            high=self.high,
            hover=self.hover,
            trials=self.trials,
        )
        if (self.values is None) != (self.colors is None):
            raise ValueError("Points: values need colors, and colors values")
        _both_ends(self)


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Bars of height y (n,) at x (n,), starting at `base` (n,) or 0.

    Several bars of one panel are grouped side by side unless they have a base.
    """

    x: Values
    y: Values
    name: str = ""
    color: Color = Color.BLUE
    base: Values | None = None
    width: float = 0.8
    low: Values | None = None
    high: Values | None = None
    hover: Sequence[str] = ()

    def __post_init__(self) -> None:
        _same_length(
            self,
            len(self.x),
            y=self.y,
            base=self.base,
            low=self.low,
            high=self.high,
            hover=self.hover,
        )
        _both_ends(self)


@dataclass(frozen=True, kw_only=True)
class Heatmap:
    """A field z (rows, columns) over x (columns,) and y (rows,), shown by colour."""

    x: Values
    y: Values
    z: Grid
    colors: ColorScale

    def __post_init__(self) -> None:
        _grid(self, self.x, self.y, self.z)


@dataclass(frozen=True, kw_only=True)
class Contour:
    """Lines along which a field z (rows, columns) over x and y has one of the `levels`."""

    x: Values
    y: Values
    z: Grid
    levels: Sequence[float]
    name: str = ""
    color: Color = Color.INK
    dash: Dash = Dash.SOLID
    width: float = 1.5
    labelled: bool = False

    def __post_init__(self) -> None:
        _grid(self, self.x, self.y, self.z)


@dataclass(frozen=True, kw_only=True)
class Region:
    """The area where a field z (rows, columns) over x and y exceeds `above`: hatched, or filled."""

    x: Values
    y: Values
    z: Grid
    above: float
    name: str = ""
    color: Color = Color.INK
    hatched: bool = True

    def __post_init__(self) -> None:
        _grid(self, self.x, self.y, self.z)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A line across the panel at `value`: of y, or of x if `vertical`."""

    value: float
    name: str = ""
    vertical: bool = False
    color: Color = Color.VERMILION
    dash: Dash = Dash.DASHED


Element = Line | Band | Points | Bars | Heatmap | Contour | Region | Limit


@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis of a panel.

    Attributes
    ----------
    label, unit
        Shown as ``label [unit]``.
    scale
        Linear or logarithmic.
    limits
        Range of the axis; from the data if not given.
    ticks
        Positions and their texts, for categories; chosen by the renderer if empty.
    """

    label: str
    unit: str = ""
    scale: Scale = Scale.LINEAR
    limits: tuple[float, float] | None = None
    ticks: Sequence[tuple[float, str]] = ()

    @property
    def title(self) -> str:
        """The label with its unit in brackets."""
        return with_unit(self.label, self.unit)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Two axes and their elements, the first one at the bottom."""

    x: Axis
    y: Axis
    elements: Sequence[Element]
    title: str = ""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure.

    Attributes
    ----------
    name
        Name of its files and identifier in a page: lower-case letters, digits, ``-`` and ``_``.
    title
        What it is for, in one line.
    caption
        How to read it, in one to three sentences.
    alternative
        Text alternative with its message, for screen readers.
    panels
        Panels, row by row.
    columns
        Number of panels in a row.
    panel_height
        Height of a panel [px at 96 px per inch].
    """

    name: str
    title: str
    caption: str
    alternative: str
    panels: Sequence[Panel]
    columns: int = 1
    panel_height: int = 360

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]+", self.name):
            raise ValueError(
                f"name: expected lower-case letters, digits, - and _, found '{self.name}'"
            )
        if not self.panels or self.columns < 1:
            raise ValueError(f"{self.name}: expected at least one panel and one column")

    @property
    def rows(self) -> int:
        """Number of rows of panels."""
        return -(-len(self.panels) // self.columns)


def _same_length(element: object, n: int, **series: Sequence[object] | Values | None) -> None:
    for name, values in series.items():
        if values is not None and len(values) not in ((n, 0) if name in OPTIONAL else (n,)):
            kind = type(element).__name__
            raise ValueError(f"{kind}: expected {n} values in {name} as in x, found {len(values)}")


def _both_ends(bars: Points | Bars) -> None:
    if (bars.low is None) != (bars.high is None):
        raise ValueError(f"{type(bars).__name__}: error bars need low and high")


def _grid(element: object, x: Values, y: Values, z: Grid) -> None:
    if z.shape != (len(y), len(x)):
        kind = type(element).__name__
        raise ValueError(f"{kind}: expected z of shape {(len(y), len(x))}, found {z.shape}")
