"""Colours can be read on their ground (WCAG 2.2, 1.4.11), and fields without seeing hues."""

import pytest

from bo_tuner.figures.figure import Color
from bo_tuner.figures.palette import DARK, DARK_GROUND, DIVERGING, LIGHT, LIGHT_GROUND, SEQUENTIAL


def luminance(shade):
    """Relative luminance of WCAG 2.2."""
    channels = [int(shade[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(("palette", "ground"), [(LIGHT, LIGHT_GROUND), (DARK, DARK_GROUND)])
def test_every_color_stands_out_from_its_ground(palette, ground):
    assert set(palette) == set(Color)
    for color in set(Color) - {Color.PAPER, Color.BLACK}:
        assert contrast(palette[color], ground) >= 3.0, color
    assert palette[Color.PAPER] == ground


def test_sequential_colors_get_brighter():
    shades = [luminance(shade) for _, shade in SEQUENTIAL]
    assert shades == sorted(shades)


def test_diverging_colors_are_brightest_in_the_middle():
    shades = [luminance(shade) for _, shade in DIVERGING]
    middle = len(shades) // 2
    assert DIVERGING[middle][0] == 0.5
    assert shades[: middle + 1] == sorted(shades[: middle + 1])
    assert shades[middle:] == sorted(shades[middle:], reverse=True)
