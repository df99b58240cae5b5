"""The context space: a box for the worst-case search, a distribution for random draws.

A text has no order. For the models a variable of m > 2 texts becomes m columns of the unit cube, as
choices among the parameters do (`bo_tuner.models.categories`): the one of its value is 1 / √2, the
others are 0.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from math import prod, sqrt

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.codec import checks
from bo_tuner.errors import ParameterError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.text import shown
from bo_tuner.trials import Context, Value

MOST_CORNER_DIMENSIONS = 5
"""Leading dimensions that corners are taken in: the number of corners doubles with each."""

CHOSEN = 1.0 / sqrt(2.0)
"""Coordinate in the column of the text that a variable has."""

CANDIDATES = 24
"""Number of contexts within the box among the candidates for the worst one."""

DISTINCT = 0.05
"""Distance in the unit cube, in some coordinate, from which on candidates differ."""


class ContextSpace:
    """Independent context variables in a fixed order.

    In the shapes, v is the number of variables (0 is allowed: no context varies), d the number of
    columns of the unit cube, which is larger only where there are texts without an order, and n any
    number of contexts. Values are in own units; a truth value or a text is its position among the
    values of the variable.

    Methods raise `ParameterError` if an array has a wrong shape or a value that is not finite.

    Parameters
    ----------
    distributions : mapping from str to Distribution
        The variables by name; its order is the order of the columns.
    integers : collection of str
        Names of the variables that have integer values.
    """

    def __init__(
        self, distributions: Mapping[str, Distribution], integers: Collection[str] = ()
    ) -> None:
        self.names = tuple(distributions)
        self.distributions = tuple(distributions.values())
        self.lower = np.array([item.lower for item in self.distributions])
        self.upper = np.array([item.upper for item in self.distributions])
        self._integer = [name in integers for name in self.names]
        # With two values one column suffices: there is only one distance.
        counts = [len(item.labels) for item in self.distributions]
        self._levels = [count if count > 2 else 0 for count in counts]
        # A metric may be the largest at any of these values, not only at the first or the last.
        self._each = [
            bool(levels) or (is_integer and isinstance(item, Discrete))
            for levels, is_integer, item in zip(
                self._levels, self._integer, self.distributions, strict=True
            )
        ]

        self._discrete = {
            column: item
            for column, item in enumerate(self.distributions)
            if isinstance(item, Discrete)
        }

    @property
    def dimension(self) -> int:
        """Number of columns of the unit cube, d."""
        return sum(levels or 1 for levels in self._levels)

    @property
    def columns(self) -> list[str]:
        """Names of the columns of the unit cube."""
        columns = []
        for name, levels in zip(self.names, self._levels, strict=True):
            columns += [f"{name}.{level}" for level in range(levels)] if levels else [name]
        return columns

    @property
    def ordered(self) -> tuple[str, ...]:
        """Variables that are numbers, which can be drawn along an axis."""
        pairs = zip(self.names, self.distributions, strict=True)
        return tuple(name for name, item in pairs if not item.labels)

    def nominal(self) -> Array:
        """Return the context (v,) of all nominal values."""
        nominal = np.array([item.number(item.nominal) for item in self.distributions])
        return np.where(self._integer, np.rint(nominal), nominal)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw n = `count` contexts (n, v) from their distribution.

        Each takes v uniform numbers, so that the same generator state gives the same first contexts
        whatever the `count`.
        """
        return self.at_quantiles(rng.random((count, len(self.names))))

    def draw_stratified(self, count: int, rng: np.random.Generator) -> Array:
        """Draw a Latin hypercube sample of n = `count` contexts (n, v).

        Each context follows the distribution, and of the n values of a variable exactly one lies in
        each of its n equally probable ranges. A mean over them has a smaller variance than one over
        independent draws.
        """
        return self.at_quantiles(latin_hypercube(count, len(self.names), rng))

    def to_contexts(self, cube: ArrayLike) -> Array:
        """Map points (n, d) of the unit cube to contexts (n, v), linearly between the bounds.

        Coordinates outside [0, 1] are clipped; a discrete variable takes its nearest possible
        value, and a text is the one with the largest coordinate.
        """
        points = np.clip(self._rows(cube, "cube", self.dimension), 0.0, 1.0)
        if any(self._levels):
            points = np.stack(list(self._decoded(points)), axis=1)
        return self.clip(self.lower + points * (self.upper - self.lower))

    def to_cube(self, contexts: ArrayLike) -> Array:
        """Map contexts (n, v) to points (n, d) of the unit cube."""
        unit = self.to_unit(contexts)
        if not any(self._levels):
            return unit
        parts = []
        for column, levels in enumerate(self._levels):
            values = unit[:, [column]]
            if levels:
                chosen = np.rint(values * (levels - 1))
                values = (chosen == np.arange(levels)) * CHOSEN
            parts.append(values)
        return np.hstack(parts)

    def to_unit(self, contexts: ArrayLike) -> Array:
        """Map contexts (n, v) to positions (n, v) between the bounds, from 0 to 1."""
        rows = self._rows(contexts, "contexts", len(self.names))
        unit: Array = (rows - self.lower) / (self.upper - self.lower)
        return np.clip(unit, 0.0, 1.0)

    def cube_of(self, contexts: Sequence[Context]) -> Array:
        """Map n contexts, by the names of their variables, to points (n, d) of the unit cube."""
        return self.to_cube(self.rows(contexts))

    def rows(self, contexts: Sequence[Context]) -> Array:
        """Return n contexts, by the names of their variables, as an array (n, v)."""
        variables = list(zip(self.names, self.distributions, strict=True))
        rows = [[item.number(context[name]) for name, item in variables] for context in contexts]
        return np.array(rows).reshape(len(rows), len(self.names))

    def clip(self, contexts: ArrayLike) -> Array:
        """Return the nearest possible contexts (n, v) for `contexts` (n, v)."""
        rows = self._rows(contexts, "contexts", len(self.names)).copy()
        for column, item in enumerate(self.distributions):
            rows[:, column] = item.clip(rows[:, column])
            if self._integer[column]:
                rows[:, column] = np.rint(rows[:, column])
        return rows

    def to_dict(self, context: ArrayLike) -> dict[str, Value]:
        """Return one context (v,) as values by name."""
        given = np.asarray(context, dtype=np.float64)[None]
        row = self._rows(given, "context", len(self.names))[0].tolist()
        variables = zip(self.names, self.distributions, self._integer, row, strict=True)
        return {
            name: round(number) if is_integer else item.value(number)
            for name, item, is_integer, number in variables
        }

    def completed(self, given: Mapping[str, Value]) -> Context:
        """Return the context with some values given, and the nominal ones elsewhere.

        Raises
        ------
        ParameterError
            If a name or a value is not possible.
        """
        numbers = self.nominal()
        for name, value in given.items():
            if name not in self.names:
                names = ", ".join(self.names) or "none, as the study has no contexts"
                raise ParameterError(f"expected {names}, found {checks.quoted(name)}")
            column = self.names.index(name)
            try:
                numbers[column] = self.distributions[column].number(value)
            except ParameterError as error:
                raise ParameterError(f"{name}: {error}") from None
        possible = self.clip(numbers[None])[0]
        nearest = self.to_dict(possible)
        for name, number, other in zip(self.names, numbers, possible, strict=True):
            if number != other:
                raise ParameterError(
                    f"{name}: expected a possible value, the nearest is {shown(nearest[name])}, "
                    f"found {checks.show(given[name])}"
                )
        return nearest

    def corners(self) -> Array:
        """Return corners of the unit cube, shape (m, d).

        With more than `MOST_CORNER_DIMENSIONS` columns they are corners of the leading ones, with
        the others halfway. Texts and listed integers have no corners: each corner of the other
        variables is taken with each of their values, or, if these are too many, with one or
        several, so that each value is met.
        """
        if any(self._each):
            return self._corners_in_each()
        axes = [[0.0, 1.0]] * min(self.dimension, MOST_CORNER_DIMENSIONS)
        points = np.full((2 ** len(axes), self.dimension), 0.5)
        if not axes:
            return points
        points[:, : len(axes)] = np.array(np.meshgrid(*axes)).reshape(len(axes), -1).T
        return points

    def _corners_in_each(self) -> Array:
        """Return the `corners` of a space that has texts or listed integers."""
        listed = {
            column: item.support
            for column, item in enumerate(self.distributions)
            if self._each[column] and isinstance(item, Discrete)
        }
        numbers = [column for column in range(len(self.names)) if column not in listed]
        leading = numbers[:MOST_CORNER_DIMENSIONS]
        ends = list(product(*([self.lower[c], self.upper[c]] for c in leading)))
        levels = list(listed.values())
        if len(ends) * prod(map(len, levels)) <= 2**MOST_CORNER_DIMENSIONS:
            pairs = [(*end, *chosen) for chosen in product(*levels) for end in ends]
        else:
            count = max(len(ends), *map(len, levels))
            pairs = [
                (*ends[k % len(ends)], *(support[k % len(support)] for support in levels))
                for k in range(count)
            ]
        rows = np.tile(0.5 * (self.lower + self.upper), (len(pairs), 1))
        rows[:, [*leading, *listed]] = pairs
        return self.to_cube(rows)

    @property
    def is_discrete(self) -> bool:
        """Whether each variable has finitely many values, listed with their probabilities."""
        return len(self._discrete) == len(self.names)

    @property
    def count_combinations(self) -> int:
        """Number of combinations of the values of the discrete variables; 1 without any."""
        return prod(len(item.support) for item in self._discrete.values())

    def combination_of(self, points: Array) -> list[tuple[float, ...]]:
        """Return the values of the discrete variables at points (n, d) of the unit cube."""
        columns = list(self._discrete)
        return [tuple(row) for row in self.to_contexts(points)[:, columns].tolist()]

    def combinations(self) -> Iterator[Array]:
        """Yield corners (m, d) of the unit cube for each combination of discrete values.

        They are corners of the leading variables of the others, as `corners`.
        """
        others = [column for column in range(len(self.names)) if column not in self._discrete]
        leading = others[:MOST_CORNER_DIMENSIONS]
        ends = list(product(*((self.lower[c], self.upper[c]) for c in leading)))
        for values in product(*(item.support for item in self._discrete.values())):
            rows = np.tile(0.5 * (self.lower + self.upper), (len(ends), 1))
            rows[:, leading] = ends
            rows[:, list(self._discrete)] = values
            yield self.to_cube(rows)

    def candidates(self, known: Sequence[Context] = ()) -> Array:
        """Return possible contexts of the unit cube over which a worst case is taken, (m, d).

        These are the corners, a Latin hypercube that is the same in every call, and the `known`
        contexts that differ from all before them.
        """
        inside = latin_hypercube(CANDIDATES, self.dimension, np.random.default_rng(0))
        candidates = self.to_cube(self.to_contexts(np.vstack([self.corners(), inside])))
        for row in self.cube_of(known):
            if (np.abs(candidates - row) > DISTINCT).any(axis=1).all():
                candidates = np.vstack([candidates, row])
        return candidates

    def at_quantiles(self, probability: Array) -> Array:
        """Return the contexts at the quantiles of each variable, both of shape (n, v)."""
        contexts = np.empty_like(probability)
        for column, item in enumerate(self.distributions):
            quantile = item.integers if self._integer[column] else item.ppf
            contexts[:, column] = quantile(probability[:, column])
        return contexts

    def _decoded(self, points: Array) -> Iterator[Array]:
        """Yield the positions (n,) of each variable between its bounds, at points (n, d)."""
        begin = 0
        for levels in self._levels:
            own = points[:, begin : begin + (levels or 1)]
            yield own.argmax(axis=1) / (levels - 1) if levels else own[:, 0]
            begin += levels or 1

    def _rows(self, values: ArrayLike, name: str, columns: int) -> Array:
        rows = np.asarray(values, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != columns:
            raise ParameterError(
                f"{name}: expected rows of {columns} values, found shape {rows.shape}"
            )
        if not np.all(np.isfinite(rows)):
            raise ParameterError(f"{name}: expected finite values")
        return rows
