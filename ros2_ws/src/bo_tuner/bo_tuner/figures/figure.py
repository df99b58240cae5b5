"""What a figure shows, in the terms of neither plotting library.

A `Figure` is a grid of panels, a panel two axes and what is drawn on them, in that order. The
renderers turn one into a PNG or SVG file (`matplotlib_renderer`) or into an interactive part of a
page (`plotly_renderer`). Colours are names: a renderer knows which shade of one can be read on
light and on dark ground. They are told apart by people who see no red or green, and whoever uses
several also gives different markers or dashes.
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
        Lowest and highest value shown; as the data need if not given.
    ticks
        Positions and their texts, for categories; as the renderer likes if empty.
    """

    label: str
    unit: str = ""
    scale: Scale = Scale.LINEAR
    limits: tuple[float, float] | None = None
    ticks: Sequence[tuple[float, str]] = ()

    @property
    def title(self) -> str:
        """The label with its unit in brackets."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Two axes and what is drawn on them, the first element at the bottom."""

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
        Of its files and its place in a page: small letters, digits, ``-`` and ``_``.
    title
        What it shows.
    caption
        How to read it, in a sentence or three.
    alternative
        What it says, for people who cannot see it.
    panels
        Row by row.
    columns
        Panels side by side.
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
        """Check what renderers rely on."""
        if not re.fullmatch(r"[a-z0-9_-]+", self.name):
            raise ValueError(f"name: expected small letters, digits, - and _, found '{self.name}'")
        if not self.panels or self.columns < 1:
            raise ValueError(f"{self.name}: expected at least one panel and one column")

    @property
    def rows(self) -> int:
        """Rows of the grid of panels."""
        return -(-len(self.panels) // self.columns)
