"""Colours can be read on their ground (WCAG 2.2, 1.4.11), and told apart without all cones."""

from itertools import combinations

import numpy as np
import pytest

from bo_tuner.figures.figure import Color
from bo_tuner.figures.palette import DARK, DARK_GROUND, DIVERGING, LIGHT, LIGHT_GROUND, SEQUENTIAL
from bo_tuner.figures.svg_renderer import RINGS
from bo_tuner.report.comparison import LINES
from bo_tuner.report.sections import convergence, trajectories
from bo_tuner.web.runs import MOST_COMPARED

SIGHT = {
    "all cones": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                 [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                [0.004733, 0.691367, 0.303900]],
}  # fmt: skip
"""Linear RGB as seen: Machado, Oliveira and Fernandes (2009), Table 1, severity 1."""

TO_XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
          [0.0193339, 0.1191920, 0.9503041]]  # fmt: skip
"""IEC 61966-2-1."""

APART = 20.0
"""Least distance in CIE 1976 L*a*b* of lines that differ in nothing else; 2.3 is just noticed."""


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
    for color in set(Color) - {Color.PAPER, Color.BLACK, Color.WHITE}:
        assert contrast(palette[color], ground) >= 3.0, color
    assert palette[Color.PAPER] == ground


@pytest.mark.parametrize("palette", [LIGHT, DARK])
def test_one_of_the_rings_around_a_mark_stands_out_from_any_color_of_a_field(palette):
    for _, shade in (*SEQUENTIAL, *DIVERGING):
        assert max(contrast(palette[color], shade) for color, _ in RINGS) >= 3.0, shade


def as_seen(shade, sight):
    """A shade in CIE 1976 L*a*b*."""
    channels = np.array([int(shade[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(SIGHT[sight] @ linear, 0.0, 1.0) / [0.95047, 1.0, 1.08883]
    x, y, z = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("palette", [LIGHT, DARK])
def test_lines_are_told_apart_by_colour_blind_readers(palette, sight):
    def distance(one, other):
        return np.linalg.norm(as_seen(palette[one], sight) - as_seen(palette[other], sight))

    default, tuned = trajectories.STYLES.values()
    for (dash, color), (other_dash, other) in combinations(LINES[:MOST_COMPARED], 2):
        assert dash != other_dash or distance(color, other) >= APART, (color, other)
    assert default[1] != tuned[1] or distance(default[0], tuned[0]) >= APART


def test_outcomes_of_trials_differ_in_shape():
    markers = [(marker, filled) for _, marker, filled in convergence.STYLES.values()]
    assert len(set(markers)) == len(markers)


def test_the_simulation_knows_what_is_confused():
    """Red and green of equal luminance, which the Ishihara plates rest on."""
    red, green = "#ce6a00", "#8f8f00"
    seen = {s: np.linalg.norm(as_seen(red, s) - as_seen(green, s)) for s in SIGHT}
    assert seen["no green"] < 0.5 * seen["all cones"]


def test_sequential_colors_get_brighter():
    shades = [luminance(shade) for _, shade in SEQUENTIAL]
    assert shades == sorted(shades)


def test_diverging_colors_are_brightest_in_the_middle():
    shades = [luminance(shade) for _, shade in DIVERGING]
    middle = len(shades) // 2
    assert DIVERGING[middle][0] == 0.5
    assert shades[: middle + 1] == sorted(shades[: middle + 1])
    assert shades[middle:] == sorted(shades[middle:], reverse=True)
