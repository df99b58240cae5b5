"""The description of a figure, independent of the plotting libraries.

A `Figure` is a grid of panels; a panel has two axes and elements in drawing order. The renderers
turn a figure into a PNG or SVG file (`matplotlib_renderer`) or into an interactive part of a page
(`plotly_renderer`). Colours are names, for which each renderer has shades that are readable on
light and dark backgrounds. They can be distinguished with red-green colour blindness, and series
of different colours also have different markers or dashes.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.figures.elements import (
    Band,
    Bars,
    Color,
    ColorScale,
    Contour,
    Dash,
    Element,
    Grid,
    Heatmap,
    Limit,
    Line,
    Marker,
    Points,
    Region,
    Scale,
    Values,
)
from bo_tuner.text import with_unit

__all__ = [
    "Axis",
    "Band",
    "Bars",
    "Color",
    "ColorScale",
    "Contour",
    "Dash",
    "Element",
    "Figure",
    "Grid",
    "Heatmap",
    "Limit",
    "Line",
    "Marker",
    "Panel",
    "Points",
    "Region",
    "Scale",
    "Values",
]


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
        Heading.
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
