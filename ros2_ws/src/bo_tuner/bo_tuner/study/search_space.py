"""The search space: maps the optimizer's unit cube to parameter sets, and back.

Scaling. A tuned parameter v with bounds [lower, upper] has the cube coordinate
z = (s(v) - s(lower)) / (s(upper) - s(lower)), where s is its scale (`parameter_scale`). All
positions that round to the same integer are repaired to the coordinate of that integer, so the
surrogates see the value that the node gets (Garrido-Merchán and Hernández-Lobato 2020).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bo_tuner.codec.checks import ParameterValue
from bo_tuner.errors import ConditionError, ParameterError, StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.study.activity import check_reach
from bo_tuner.study.conditions import check_shares
from bo_tuner.study.conforming import Conforming
from bo_tuner.study.limit_kinds.limited import LOWER, UPPER
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parameter_scale import LOG, SYMLOG, places_at, scaled, unscaled
from bo_tuner.study.parameter_space import ParameterSpace
from bo_tuner.trials import Value

# Doubles that differ by less than this fraction of their range count as the same value.
RESOLUTION = 1e-6

STEP = 0.05
"""Step to a neighbour, as a fraction of a double's range on its scale; an integer's step is 1.

It is no option, so that the sensitivity to a step can be compared between runs.
"""

SAMPLE = 2**16
"""Parameter sets by which the share that the conditions leave is estimated."""

MOST_ANCHORS = 512
"""Largest number of permitted parameter sets of the sample towards which others are moved."""

ROUNDS = 100
BATCH = 1024
"""Random parameter sets that are drawn at once, until enough of them are permitted."""


class SearchSpace:
    """The unit cube over the tuned parameters.

    In the shapes, d is the number of tuned parameters and n any number of parameter sets, with
    values in own units. An argument needs the tuned parameters only; a returned parameter set has
    all, tied and fixed ones included, in the study's order. A conditional parameter that is not
    active has its default in it.

    Methods raise `ParameterError` if a tuned parameter is missing, of a wrong type or out of
    bounds, a name is unknown, or positions have a wrong shape or are not finite.

    Parameters
    ----------
    parameters : iterable of Parameter
        All parameters of the study; the tuned ones become the columns, in this order.
    order : sequence of (str, str)
        Names (a, b) of parameters with a <= b in every parameter set.
    where : sequence of str
        Conditions that hold in every parameter set, such as ``ki <= kp / 2``. One of a parameter
        that is not active does not count. Of the tuned doubles in a linear equality, such as
        ``a + b + c == 1``, the last one follows from the others, and is no column.

    Attributes
    ----------
    parameters : tuple of Parameter
        All parameters.
    order : tuple of (str, str)
        As given.
    names : tuple of str
        Tuned parameters, one for each column.
    lower, upper : ndarray, shape (d,)
        Bounds of the tuned parameters, in their own units; for a parameter that is no number, of
        the position among its levels.
    integer, discrete : ndarray of bool, shape (d,)
        Which of them are integers, and which are integers, booleans or choices.

    Raises
    ------
    StudyError
        If a reference is unknown, no parameter is tuned, or the order or the conditions cannot be
        satisfied, or are violated by the defaults.
    """

    def __init__(
        self,
        parameters: Iterable[Parameter],
        order: Sequence[tuple[str, str]] = (),
        where: Sequence[str] = (),
    ) -> None:
        self._space = ParameterSpace(parameters, order, where)
        self.parameters = self._space.parameters
        self.order = self._space.order
        self.names = self._space.names
        self.lower = self._space.lower
        self.upper = self._space.upper
        self._tuned = self._space.tuned
        self.integer = np.array([item.is_integer and item.is_number for item in self._tuned])
        self.discrete = np.array([not item.is_number or item.is_integer for item in self._tuned])
        self._in_steps = self.integer | np.array([item.has_order for item in self._tuned])
        self._stepped = [c for c, item in enumerate(self._tuned) if item.step is not None]
        self._on_scale = {
            scale: np.array([item.scale == scale for item in self._tuned])
            for scale in (LOG, SYMLOG)
        }
        self._scaled_lower = self._scaled(self.lower)
        self._scaled_width = self._scaled(self.upper) - self._scaled_lower
        self._width = self.upper - self.lower
        self._order = self._space.partial_order
        # The bounds, tightened by the order.
        self._low, self._high = self._space.permitted
        # The decimal place of a double, on its scale, in which two parameter sets must differ.
        self._places = [
            None if discrete else -math.floor(math.log10(RESOLUTION * width))
            for discrete, width in zip(self.discrete, self._scaled_width.tolist(), strict=True)
        ]
        if self._space.conditions or self._space.activity.names:
            self._check_conditions()

    @property
    def dimension(self) -> int:
        """Number of tuned parameters, d."""
        return len(self.names)

    @property
    def levels(self) -> tuple[int, ...]:
        """Number of values without an order, for each column; 0 for one with an order."""
        # With two values one column suffices: there is only one distance.
        counts = (0 if item.has_order else len(item.levels) for item in self._tuned)
        return tuple(count if count > 2 else 0 for count in counts)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Tuned parameters that are numbers, which can be drawn along an axis."""
        return tuple(item.name for item in self._tuned if item.is_number)

    @property
    def defaults(self) -> dict[str, Value]:
        """The hand-tuned parameter set, including tied and fixed parameters."""
        return dict(self._space.defaults)

    def inactive(self, parameters: Mapping[str, Value]) -> frozenset[str]:
        """Return the names of the parameters that a parameter set does not have."""
        if not self._space.activity.names:
            return frozenset()
        return self._space.inactive(self._space.row(parameters))

    def active(self, parameters: Mapping[str, Value]) -> dict[str, Value]:
        """Return the parameters that a parameter set has, without those that are not active."""
        inactive = self.inactive(parameters)
        return {name: value for name, value in parameters.items() if name not in inactive}

    def has(self, name: str, points: Array) -> NDArray[np.bool_]:
        """Return at which repaired points (n, d) of the cube a parameter is active, shape (n,)."""
        values = self._free_values(points)
        return self._space.active(values).get(name, np.ones(len(points), dtype=np.bool_))

    def branch(self, parameters: Mapping[str, Value]) -> str:
        """Return which branch a parameter set is in, in words; empty if nothing is conditional."""
        return self._space.activity.branch(self.active(parameters))

    def to_parameters(self, cube: ArrayLike) -> dict[str, Value]:
        """Return the repaired parameter set at a point (d,) of the unit cube.

        Doubles are rounded to the decimal place at or below `RESOLUTION` times their range, on a
        scale to that of their size, unless that breaks the order or a condition.
        """
        point = np.asarray(cube, dtype=np.float64)
        if point.shape != (self.dimension,):
            raise ParameterError(f"cube: expected shape ({self.dimension},), found {point.shape}")
        return self._space.complete(self._rounded(self._values(point[None]))[0])

    def to_cube(self, parameters: Mapping[str, Value]) -> Array:
        """Return the point (d,) of the unit cube for a parameter set."""
        return self._to_unit(self._space.row(parameters))

    def cube_of(self, parameter_sets: Iterable[Mapping[str, Value]]) -> Array:
        """Return the points (n, d) of the unit cube for n parameter sets."""
        rows = [self.to_cube(parameters) for parameters in parameter_sets]
        return np.array(rows).reshape(-1, self.dimension)

    def completed(self, parameters: Mapping[str, Value]) -> dict[str, Value]:
        """Return all parameters for the tuned ones."""
        return self._space.complete(self._space.row(parameters))

    def permitted(self, parameters: Mapping[str, ParameterValue]) -> dict[str, Value]:
        """Return all parameters for the tuned ones of a set that satisfies order and conditions.

        Raises
        ------
        ParameterError
            If the order is violated, or the class's rules for its arguments are.
        ConditionError
            If a condition is violated.
        """
        row = self._space.row(parameters)
        self._space.check_order(row)
        self._space.check_conditions(row)
        return self._space.complete(row)

    def repair(self, positions: ArrayLike) -> Array:
        """Move positions (n, d) to points (n, d) that represent permitted parameter sets.

        Clips to the cube, moves parameters in the wrong order to their mean, rounds integers, and
        moves what breaks a condition straight towards a parameter set that breaks none, no farther
        than needed. A second repair changes nothing (to rounding).
        """
        rows = np.asarray(positions, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.dimension:
            raise ParameterError(
                f"positions: expected shape (n, {self.dimension}), found {rows.shape}"
            )
        return self._to_unit(self._values(rows))

    @property
    def has_prior(self) -> bool:
        """Whether something is believed of where the best parameter set is."""
        return any(item.prior is not None for item in self.parameters)

    def log_prior(self, points: Array) -> Array:
        """Return the logarithm of the prior density (n,) at repaired points (n, d) of the cube.

        It is 0 where the density is largest.
        """
        scaled = self._scaled_lower + points * self._scaled_width
        return self._space.log_prior(self._unscaled(scaled))

    def dependent(self, points: Array) -> dict[str, Array]:
        """Return the coordinates (n,), by name, of parameters that follow from an equality.

        Parameters
        ----------
        points : ndarray, shape (n, d)
            Repaired points of the unit cube.
        """
        values = self._unscaled(self._scaled_lower + points * self._scaled_width)
        return {
            each.dependent: each.shares(values[:, self._space.columns_of(each)])
            for each in self._space.equalities
        }

    def key(self, parameters: Mapping[str, Value]) -> tuple[Value, ...]:
        """Return a hashable key that equal parameter sets share.

        The tuned values: integers unchanged, doubles on their scale, rounded to the decimal place
        at or below `RESOLUTION` times their range there.
        """
        row = self._space.row(parameters)
        return tuple(
            int(value) if places is None else round(scaled, places)
            for value, scaled, places in zip(
                row.tolist(), self._scaled(row).tolist(), self._places, strict=True
            )
        )

    def at_bounds(self, parameters: Mapping[str, Value]) -> dict[str, str]:
        """Return which tuned numbers are at a bound, ``lower`` or ``upper``, by their names.

        A double is at a bound if it differs from it by no more than `RESOLUTION` times its range,
        on its scale. For a number with a step, the last step counts as the upper bound.
        """
        row = self._space.row(parameters)
        last = np.array(
            [item.on_grid(b) for item, b in zip(self._tuned, self.upper.tolist(), strict=True)]
        )
        near = np.where(self.discrete, 0.0, RESOLUTION) * self._scaled_width
        scaled = self._scaled(row)
        sides: dict[str, str] = {}
        for side, bound in ((LOWER, self.lower), (UPPER, last)):
            at = np.abs(scaled - self._scaled(bound)) <= near
            sides |= {item.name: side for item, a in zip(self._tuned, at, strict=True) if a}
        active = self.active(parameters)
        return {name: sides[name] for name in self.numbers if name in sides and name in active}

    def latin_hypercube(
        self,
        count: int,
        rng: np.random.Generator,
        taken: Iterable[Mapping[str, Value]] = (),
    ) -> Array:
        """Draw a space-filling design (McKay, Beckman and Conover 1979).

        Each parameter's permitted range is divided into n strata with one point in each, equal on
        its scale; all integers, and all values of a grid with a step, are equally likely on any
        scale, including the outermost, as long as no order is to be kept. Values in the wrong order
        are swapped, so of two in order the lower one tends to be low and the upper one high; what
        breaks a condition is drawn anew; parameters of an equality are drawn uniformly in its
        plane; repeated parameter sets are moved to the nearest free
        integers.

        Parameters
        ----------
        count : int
            Number of points, n, at least 1.
        rng : numpy.random.Generator
            Draws the order of the strata and the position within each.
        taken : iterable of mapping
            Parameter sets that the points shall differ from as well.

        Returns
        -------
        ndarray, shape (n, d)
            Repaired points of the unit cube, all different if the space has enough.
        """
        if count < 1:
            raise ParameterError(f"count: expected at least 1 point, found {count}")
        values = self._drawn(count, rng)
        if self._space.conditions:
            values = self._conforming(self._drawn_anew(values, rng))
        points = self._to_unit(values)
        return self._distinct(points, {self.key(parameters) for parameters in taken})

    def _drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Draw values (n, d) in a Latin hypercube, in order and rounded."""
        uniform = latin_hypercube(count, self.dimension, rng)
        low, high = self._scaled(self._low), self._scaled(self._high)
        values = self._unscaled(low + uniform * (high - low))
        choices = self._high - self._low + 1.0
        integers = np.minimum(self._low + np.floor(uniform * choices), self._high)
        values = np.where(self.discrete, integers, values)
        for column in self._stepped:
            lowest, step = self.lower[column], float(self._tuned[column].step or 0.0)
            steps = round((self._tuned[column].on_grid(self.upper[column]) - lowest) / step)
            chosen = np.floor(uniform[:, column] * (steps + 1))
            values[:, column] = lowest + np.minimum(chosen, steps) * step
        for equality in self._space.equalities:
            values[:, self._space.columns_of(equality)] = equality.draw(count, rng)
        return self._ordered(self._order.swap(values))

    def _drawn_anew(self, values: Array, rng: np.random.Generator) -> Array:
        """Return values (n, d) with the rows that break a condition drawn again.

        If few sets satisfy the conditions, some may still break one after all draws.
        """
        drawn = values.copy()
        wrong = np.flatnonzero(~self._space.holds(drawn))
        for _ in range(ROUNDS):
            if not len(wrong):
                break
            fresh = self._drawn(BATCH, rng)
            fresh = fresh[self._space.holds(fresh)][: len(wrong)]
            drawn[wrong[: len(fresh)]] = fresh
            wrong = wrong[len(fresh) :]
        return drawn

    def minimum_length_scales(self) -> Array:
        """Return lower bounds of the kernel's length scales in the unit cube, shape (d,).

        A squared-exponential kernel correlates integers that are d apart in the cube by at least
        c = `minimum_correlation` if l >= d / sqrt(-2 ln c). Here d is the largest distance between
        neighbours: 1 / (upper - lower) on the linear scale, the one of the two lowest on another.
        The paper's 0.22 is this bound in its own scaling of the horizons, for c = 0.1 (Sec. 3).
        0 where the study sets no minimum.
        """
        scales = np.zeros(self.dimension)
        step = self._to_unit(self.lower + [item.step or 1.0 for item in self._tuned])
        for column, item in enumerate(self._tuned):
            if item.minimum_correlation is not None:
                reach = np.sqrt(-2.0 * np.log(item.minimum_correlation))
                scales[column] = step[column] / reach
        return scales

    def integer_neighbours(self, parameters: Mapping[str, Value]) -> list[dict[str, Value]]:
        """Return the permitted parameter sets one integer step away.

        For each tuned integer, one step below and one above where bounds, order and conditions
        permit it, likewise for choices in an order; for each boolean or other choice, every other
        value. Doubles keep their values, tied
        parameters follow.
        """
        row = self._space.row(parameters)
        steps = self._steps(row, self.discrete)
        return [self._space.complete(moved) for moved in steps]

    def integer_neighbour_points(self, parameters: Mapping[str, Value]) -> Array:
        """Return the points (m, d) of the unit cube one step of an integer away.

        They are the points of `integer_neighbours`, except those that differ in a choice without an
        order: it has no steps.
        """
        return self._to_unit(self._steps(self._space.row(parameters), self._in_steps))

    def _steps(self, row: Array, which: NDArray[np.bool_]) -> Array:
        """Return the tuned values (m, d) one step from a row (d,), in `which` discrete columns."""
        steps = [np.empty((0, len(row)))]
        for column in np.flatnonzero(which):
            item = self._tuned[column]
            size = float(item.step or 1.0)
            away = np.array([-size, size])
            if item.levels and not item.has_order:
                away = np.arange(len(item.levels)) - row[column]
            moved = np.tile(row, (len(away), 1))
            moved[:, column] += away
            inside = (self._low[column] <= moved[:, column]) & (
                moved[:, column] <= self._high[column]
            )
            moved = self._space.canonical(moved[inside])
            permitted = self._order.satisfied(moved) & self._space.holds(moved)
            steps.append(moved[(moved != row).any(axis=1) & permitted])
        return np.concatenate(steps)

    def neighbours(self, parameters: Mapping[str, Value]) -> list[dict[str, Value]]:
        """Return the permitted parameter sets one step away, for a double `STEP` times its range.

        The integer neighbours, then for each tuned double one below and one above, repaired to
        bounds and order; a step that breaks a condition ends where that begins.
        """
        neighbours = self.integer_neighbours(parameters)
        row = self._space.row(parameters)
        at = self._to_unit(self._free_values(self.to_cube(parameters)[None]))
        for column in np.flatnonzero(~self.discrete):
            for sign in (-1.0, 1.0):
                moved = at.copy()
                moved[0, column] += sign * STEP
                moved = self._to_unit(self._free_values(moved))
                # Values that do not move are kept bit for bit.
                values = np.where(moved == at, row, self._free_values(moved))
                if column in self._stepped and not np.any(moved != at):
                    values = row[None].copy()
                    values[0, column] += sign * float(self._tuned[column].step or 0.0)
                    values = self._ordered(values)
                if not self._space.holds(values)[0]:
                    values = self._conditions.towards(row[None], values)
                    if np.abs(self._to_unit(values) - at).max() <= RESOLUTION:
                        continue
                if np.any(values != row):
                    neighbours.append(self._space.complete(values[0]))
        return neighbours

    def _values(self, positions: Array) -> Array:
        """Return permitted tuned values, shape (n, d), at positions of shape (n, d)."""
        return self._conforming(self._free_values(positions))

    def _rounded(self, values: Array) -> Array:
        """Return one row of values (1, d) without the noise digits that the cube leaves."""
        row = [
            value if item.is_integer or not item.is_number else round(value, self._place(k, value))
            for k, (item, value) in enumerate(zip(self._tuned, values[0].tolist(), strict=True))
        ]
        at_bound = (values == self._low) | (values == self._high)
        rounded = np.where(at_bound, values, np.clip([row], self._low, self._high))
        rounded = self._space.canonical(self._space.on_equalities(rounded))
        permitted = self._order.satisfied(rounded) & self._space.holds(rounded)
        return rounded if permitted.all() else values

    def _place(self, column: int, value: float) -> int:
        """Return the decimal place that a double is rounded to."""
        item, places = self._tuned[column], self._places[column]
        if item.step is not None or places is None:
            # A multiple of the step, which is to stay one.
            return 9 - math.floor(math.log10(item.step or 1.0))
        return places_at(item.scale, value, float(self.upper[column]), places)

    def _free_values(self, positions: Array) -> Array:
        """Return tuned values (n, d) at positions (n, d), permitted but for the conditions."""
        if not np.all(np.isfinite(positions)):
            raise ParameterError("positions: expected finite values")
        scaled = self._scaled_lower + np.clip(positions, 0.0, 1.0) * self._scaled_width
        return self._ordered(self._unscaled(scaled))

    @cached_property
    def _conditions(self) -> Conforming:
        """Moves values that break a condition, towards some that break none."""
        drawn = self._drawn(SAMPLE, np.random.default_rng(0))
        default = self._space.row(self.defaults)
        return Conforming(
            self._space.holds,
            self._to_unit,
            self._free_values,
            np.vstack([default, drawn[self._space.holds(drawn)][:MOST_ANCHORS]]),
            np.array(self.levels, dtype=bool),
        )

    def _conforming(self, values: Array) -> Array:
        """Return values (n, d) that satisfy the conditions; those that do stay as they are."""
        return self._conditions.moved(values) if self._space.conditions else values

    def _check_conditions(self) -> None:
        """Refuse conditions that hardly any set satisfies, and defaults that break one."""
        drawn = self._drawn(SAMPLE, np.random.default_rng(0))
        check_shares(self._space.conditions, self._space.held(drawn))
        active = self._space.active(drawn[self._space.holds(drawn)])
        check_reach([(item, active[item.name]) for item in self._tuned if item.when])
        try:
            self.permitted(self.defaults)
        except ConditionError as error:
            broken = (each for each in self._space.conditions if each.text == error.condition)
            raise StudyError(f"the default {error}", next(broken).path) from None

    def _ordered(self, values: Array) -> Array:
        """Return values (n, d) in order, rounded and within the bounds."""
        ordered = self._order.project(values)
        # Rounding and clipping to tightened bounds both keep the order.
        rounded = np.where(self.discrete, np.floor(ordered + 0.5), ordered)
        for column in self._stepped:
            rounded[:, column] = [self._tuned[column].on_grid(v) for v in rounded[:, column]]
        clipped = np.clip(rounded, self._low, self._high)
        return self._space.canonical(self._space.on_equalities(clipped))

    def _to_unit(self, values: Array) -> Array:
        unit: Array = (self._scaled(values) - self._scaled_lower) / self._scaled_width
        return unit

    def _scaled(self, values: Array) -> Array:
        """Return s(v) for values of shape (..., d)."""
        transformed = values.copy()
        for scale, columns in self._on_scale.items():
            transformed[..., columns] = scaled(scale, values[..., columns], self.upper[columns])
        return transformed

    def _unscaled(self, positions: Array) -> Array:
        """Return v for s(v) of shape (n, d)."""
        values = positions.copy()
        for scale, columns in self._on_scale.items():
            values[:, columns] = unscaled(scale, positions[:, columns], self.upper[columns])
        return values

    def _distinct(self, points: Array, seen: set[tuple[Value, ...]]) -> Array:
        """Move repeated points to the nearest free parameter set in integer steps."""
        points = points.copy()
        for index, point in enumerate(points):
            layer = [self.to_parameters(point)]
            visited = {self.key(layer[0])}
            while layer:
                free = [item for item in layer if self.key(item) not in seen]
                if free:
                    points[index] = self.to_cube(free[0])
                    seen.add(self.key(free[0]))
                    break
                steps = [step for item in layer for step in self.integer_neighbours(item)]
                layer = []
                for step in steps:
                    if self.key(step) not in visited:
                        visited.add(self.key(step))
                        layer.append(step)
            if not layer and self.discrete.all():
                # All parameter sets are taken: no other point can be moved either.
                return points
        return points


@lru_cache(maxsize=16)
def search_space(
    parameters: tuple[Parameter, ...], order: tuple[tuple[str, str], ...], where: tuple[str, ...]
) -> SearchSpace:
    """Return the `SearchSpace`, made once: sampling the conditions takes tenths of a second."""
    return SearchSpace(parameters, order, where)
