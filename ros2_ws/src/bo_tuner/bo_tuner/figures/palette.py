"""Shades of the named colours on light and dark backgrounds, and the colour maps.

Each shade but paper, black and white has a contrast of at least 3:1 against the background of its
palette, as WCAG 2.2 (1.4.11) requires for graphics. The hues are those of Okabe and Ito (2008),
with another lightness where the contrast requires it.
"""

from bo_tuner.figures.figure import Color

LIGHT_GROUND = "#ffffff"
DARK_GROUND = "#14181d"

LIGHT = {
    Color.BLUE: "#0072b2",
    Color.ORANGE: "#b97700",
    Color.GREEN: "#008761",
    Color.VERMILION: "#cc4b00",
    Color.PURPLE: "#a6447c",
    Color.SKY: "#2a8cc4",
    Color.GRAY: "#6f7780",
    Color.INK: "#1c232b",
    Color.PAPER: LIGHT_GROUND,
    Color.BLACK: "#101418",
    Color.WHITE: "#ffffff",
}

DARK = {
    Color.BLUE: "#4aa8e8",
    Color.ORANGE: "#f0ad2e",
    Color.GREEN: "#2cc295",
    Color.VERMILION: "#ff8552",
    Color.PURPLE: "#e58fbe",
    Color.SKY: "#8ed1fa",
    Color.GRAY: "#949da8",
    Color.INK: "#e6eaee",
    Color.PAPER: DARK_GROUND,
    Color.BLACK: "#101418",
    Color.WHITE: "#ffffff",
}

SEQUENTIAL = (
    (0.0, "#00204d"),
    (0.125, "#0b3370"),
    (0.25, "#3c4d6e"),
    (0.375, "#5d646f"),
    (0.5, "#7c7b78"),
    (0.625, "#9c9474"),
    (0.75, "#bfae67"),
    (0.875, "#e2ca50"),
    (1.0, "#ffea46"),
)
"""Cividis (Nuñez, Anderton and Renslow 2018): dark to bright, safe for colour blindness."""

DIVERGING = (
    (0.0, "#0b4f8a"),
    (0.25, "#4b98c9"),
    (0.5, "#f2f1ee"),
    (0.75, "#e07a52"),
    (1.0, "#a3210f"),
)
"""Blue below, red above, near white at the middle."""
