"""Grids over tuned parameters, in their own units and in the unit cube."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bo_tuner.figures.figure import Axis, Scale
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parts import LOG
from bo_tuner.study.study import Study
from bo_tuner.trials import Value

POINTS = 41
"""Largest number of points along an axis of a contour plot."""

FINE = 81
"""Largest number of points along a slice."""


@dataclass(frozen=True, eq=False)
class ParameterGrid:
    """A grid of values of one tuned parameter.

    Attributes
    ----------
    name
        The parameter.
    column
        Its column in the unit cube.
    values
        Values (n,) in its unit.
    cube
        Their cube coordinates (n,).
    axis
        The axis that shows them.
    """

    name: str
    column: int
    values: Array
    cube: Array
    axis: Axis


def parameter_grid(study: Study, name: str, at: Mapping[str, Value], most: int) -> ParameterGrid:
    """Return a grid of at most `most` values between the bounds; `at` is a parameter set.

    Those of an integer or of a parameter with a step are values that it can have.
    """
    space = study.search_space()
    item = study.parameters[name]
    column = space.names.index(name)
    lower, upper = float(space.lower[column]), float(space.upper[column])
    log = item.scale == LOG
    values = np.geomspace(lower, upper, most) if log else np.linspace(lower, upper, most)
    if item.is_integer:
        values = np.round(values)
    values = np.unique([item.on_grid(value) for value in values])
    # Rounding must not leave the bounds.
    values = np.clip(values, lower, upper)
    kind = int if item.is_integer else float
    cube = [space.to_cube(dict(at) | {name: kind(value)})[column] for value in values]
    axis = Axis(
        label=item.title,
        unit=item.unit,
        scale=Scale.LOG if log else Scale.LINEAR,
        limits=(lower, upper),
    )
    return ParameterGrid(name, column, values, np.array(cube), axis)


def permitted(study: Study, points: Array) -> np.ndarray:
    """Return which points (n, d) of the cube are parameter sets of the study, shape (n,)."""
    moved = np.abs(study.search_space().repair(points) - points)
    kept: np.ndarray = moved.max(axis=1) < 1e-9
    return kept
