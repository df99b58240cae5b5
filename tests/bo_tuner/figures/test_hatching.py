"""Hatching: lines where a field exceeds a level, and nowhere else."""

import numpy as np

from bo_tuner.figures.figure import Region, Scale
from bo_tuner.figures.hatching import hatching


def test_the_lines_are_where_the_field_exceeds_the_level():
    """Of the field x + y over a square whose axes differ in scale, the level 1 is a diagonal."""
    x, y = np.geomspace(1.0, 100.0, 21), np.linspace(-3.0, 3.0, 31)
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 31))
    across, up = hatching(Region(x=x, y=y, z=u + v, above=1.2), Scale.LOG)
    drawn = np.isfinite(across)
    place = np.interp(np.log(across[drawn]), np.log(x), u[0]) + np.interp(up[drawn], y, v[:, 0])
    assert place.min() > 1.2 - 1e-9
    # They cover the corner, and begin at the level.
    assert place.max() > 1.8
    assert place.min() < 1.25
    # Lines, not points: there are far fewer gaps than points.
    assert 5 < np.sum(~drawn) < 0.1 * np.sum(drawn)


def test_the_lines_are_straight_on_a_log_axis_of_integers():
    """Where the places of the grid are not even they would bend, and look like contours."""
    x, y = np.array([2.0, 3.0, 5.0, 20.0, 40.0]), np.linspace(0.0, 1.0, 5)
    across, up = hatching(Region(x=x, y=y, z=np.ones((5, 5)), above=0.5), Scale.LOG)
    along = (np.log(across) - np.log(2.0)) / (np.log(40.0) - np.log(2.0))
    offset = along - up
    within = np.isfinite(offset[1:]) & np.isfinite(offset[:-1])
    assert np.abs(np.diff(offset)[within]).max() < 1e-9


def test_nothing_is_hatched_where_nothing_exceeds_it():
    across, up = hatching(Region(x=[0.0, 1.0], y=[0.0, 1.0], z=np.zeros((2, 2)), above=0.5))
    assert len(across) == len(up) == 0
