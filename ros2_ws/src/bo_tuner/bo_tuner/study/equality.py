"""Linear equalities of tuned doubles, such as ``a + b + c == 1``: the last one is eliminated.

Their sets lie in a plane of the box between the bounds. They are drawn uniformly in it, and a set
beyond it is moved to the nearest one.
"""

import ast
import math
from collections.abc import Iterable, Mapping

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.expressions import Expression, ExpressionError
from bo_tuner.numerics.plane_in_cube import PlaneInCube
from bo_tuner.study.conditions import KEY
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parameter_scale import LINEAR

DIGITS = 12
"""Digits of the value that follows from the others, as a share of its range."""

TOLERANCE = 1e-9
"""Largest share of the range by which it may lie outside of its bounds."""


class Equality:
    """A linear equality of m tuned doubles.

    Parameters
    ----------
    text : str
        The equality.
    index : int
        Its place among the conditions of the study.
    members : sequence of Parameter
        The doubles.
    plane : PlaneInCube
        The equality for the members between their bounds, 0 at the lower and 1 at the upper one.

    Attributes
    ----------
    names : tuple of str
        The m - 1 members that are free.
    dependent : str
        The one that follows from them: the last.
    """

    def __init__(
        self, text: str, index: int, members: Iterable[Parameter], plane: PlaneInCube
    ) -> None:
        self.text, self.path = text, (KEY, index)
        *free, last = (item.name for item in members)
        self.names, self.dependent = tuple(free), last
        self._plane = plane
        bounds = np.array([item.bounds for item in members], dtype=np.float64)
        self._lower, self._width = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
        self._decimals = DIGITS - math.floor(math.log10(self._width[-1]))

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw values (count, m - 1) of the free members, uniformly in the plane."""
        return self._own(self._plane.draw(count, rng))

    def nearest(self, values: Array) -> Array:
        """Return values (n, m - 1) of the free members, moved where the last is out of bounds."""
        last = self._last(values)
        outside = (last < 0.0) | (last > 1.0)
        if not outside.any():
            return values
        moved = values.copy()
        cube = np.column_stack([self._cube(values[outside]), last[outside]])
        moved[outside] = self._own(self._plane.nearest(cube))
        return moved

    def holds(self, values: Array) -> Array:
        """Return 1 where the last member lies within its bounds, and else 0, of shape (n,)."""
        last = self._last(values)
        return np.where((last >= -TOLERANCE) & (last <= 1.0 + TOLERANCE), 1.0, 0.0)

    def shares(self, values: Array) -> Array:
        """Return where the last member lies between its bounds, 0 to 1, of shape (n,)."""
        return np.clip(self._last(values), 0.0, 1.0)

    def values(self, columns: Mapping[str, Array]) -> Array:
        """Return the values (n,) of the last member, within its bounds, for those of all others."""
        last = self._last(np.column_stack([columns[name] for name in self.names]))
        upper = self._lower[-1] + self._width[-1]
        values = np.round(self._lower[-1] + last * self._width[-1], self._decimals)
        clipped: Array = np.clip(values + 0.0, self._lower[-1], upper)  # no "-0"
        return clipped

    def check_default(self, default: float, follows: float) -> None:
        """Refuse a default of the last member that is not what follows from the others.

        Raises
        ------
        StudyError
            With both.
        """
        if abs(default - follows) > TOLERANCE * self._width[-1]:
            raise StudyError(
                f"'{self.text}' does not hold for the defaults: {self.dependent} is {default:g}, "
                f"where the others leave {follows:g}",
                self.path,
            )

    def _cube(self, values: Array) -> Array:
        cube: Array = (values - self._lower[:-1]) / self._width[:-1]
        return cube

    def _own(self, cube: Array) -> Array:
        own: Array = self._lower[:-1] + cube[:, :-1] * self._width[:-1]
        return own

    def _last(self, values: Array) -> Array:
        *others, of_last = self._plane.coefficients
        last: Array = (self._plane.total - self._cube(values) @ np.array(others)) / of_last
        return last


def equality_of(text: str, index: int, parameters: Mapping[str, Parameter]) -> Equality | None:
    """Return the equality that a condition is; None for any other one, also a nonlinear equality.

    Raises
    ------
    StudyError
        If it cannot hold within the bounds, or a parameter in it is none that can be eliminated.
    """
    expression = _difference(text, parameters)
    if expression is None:
        return None
    leaders = {name: parameters[name].leader(parameters) for name in expression.names}
    if any(item.type != "double" or item.is_derived for item in leaders.values()):
        return None
    members = [item for item in parameters.values() if item.is_tuned and item in leaders.values()]
    if len(members) < 2 or not all(item.is_number for item in members):
        return None
    rows = _probes(members)
    columns = {
        name: np.full(len(rows), float(item.fixed or 0.0))
        if item not in members
        else rows[:, members.index(item)]
        for name, item in leaders.items()
    }
    differences = np.broadcast_to(expression(columns), len(rows))
    plane, base = _plane(differences, len(members))
    if plane is None:
        return None
    for item in members:
        for key, is_plain in (
            ("step", item.step is None),
            ("when", not item.when),
            ("scale", item.scale == LINEAR),
        ):
            if not is_plain:
                raise StudyError(f"'{item.name}' has a {key}; a double in an equality has none")
    low, high = (base + sum(end(a, 0.0) for a in plane.coefficients) for end in (min, max))
    if not low < 0.0 < high:
        raise StudyError(
            f"'{text}' cannot hold: within the bounds its left side minus its right one is "
            f"{low:g} to {high:g}"
        )
    return Equality(text, index, members, plane)


def _difference(text: str, parameters: Mapping[str, Parameter]) -> Expression | None:
    """Return left minus right side of an equality; None if a text is none of numbers."""
    try:
        node = ast.parse(text.strip(), mode="eval").body
        if not (isinstance(node, ast.Compare) and [type(o) for o in node.ops] == [ast.Eq]):
            return None
        left, right = map(ast.unparse, (node.left, node.comparators[0]))
        return Expression(f"({left}) - ({right})", tuple(parameters))
    except (SyntaxError, ValueError, RecursionError, MemoryError, ExpressionError):
        return None


def _probes(members: list[Parameter]) -> Array:
    """Return values (m + 4, m): all lower bounds, each upper one in its turn, three at random."""
    bounds = np.array([item.bounds for item in members], dtype=np.float64)
    size = len(members)
    random = np.random.default_rng(0).random((3, size))
    cube = np.vstack([np.zeros(size), np.eye(size), random])
    probes: Array = bounds[:, 0] + cube * (bounds[:, 1] - bounds[:, 0])
    return probes


def _plane(differences: Array, size: int) -> tuple[PlaneInCube | None, float]:
    """Return the plane of differences that are 0, from those at the probes, and the first."""
    base = float(differences[0])
    coefficients = differences[1 : size + 1] - base
    random = np.random.default_rng(0).random((3, size))
    wrong = np.abs(base + random @ coefficients - differences[size + 1 :])
    largest = TOLERANCE * np.abs(differences).max()
    if not (np.isfinite(differences).all() and (wrong <= largest).all() and coefficients.all()):
        return None, base
    return PlaneInCube(coefficients, -base), base
