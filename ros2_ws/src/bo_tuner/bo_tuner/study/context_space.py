"""The context space: a box for the worst-case search, a distribution for random draws."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.errors import ParameterError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.latin_hypercube import latin_hypercube
from bo_tuner.study.distributions import Distribution

MOST_CORNER_DIMENSIONS = 5
"""Corners are those of so many leading dimensions: their number doubles with each."""

CANDIDATES = 24
"""Contexts within the box among the candidates for the worst one."""

DISTINCT = 0.05
"""Distance in the unit cube, in some coordinate, from which on candidates differ."""


class ContextSpace:
    """Independent context variables in a fixed order.

    In the shapes below, d is the number of variables (0 is allowed: no context varies) and n any
    number of contexts, whose values are in own units.

    Methods raise `ParameterError` if an array has a wrong shape or a value that is not finite.

    Parameters
    ----------
    distributions : mapping from str to Distribution
        The variables by name; its order is the order of the columns.
    """

    def __init__(self, distributions: Mapping[str, Distribution]) -> None:
        self.names = tuple(distributions)
        self.distributions = tuple(distributions.values())
        self.lower = np.array([item.lower for item in self.distributions])
        self.upper = np.array([item.upper for item in self.distributions])

    @property
    def dimension(self) -> int:
        """Number of context variables, d."""
        return len(self.names)

    def nominal(self) -> Array:
        """Return the context (d,) of all nominal values."""
        return np.array([item.nominal for item in self.distributions])

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw n = `count` contexts (n, d) from their distribution.

        Each takes d uniform numbers, so that the same generator state gives the same first contexts
        whatever the `count`.
        """
        return self._at_quantiles(rng.random((count, self.dimension)))

    def draw_stratified(self, count: int, rng: np.random.Generator) -> Array:
        """Draw a Latin hypercube sample of n = `count` contexts (n, d), see `latin_hypercube`.

        Each context follows the distribution, and of the n values of a variable exactly one lies in
        each of its n equally probable ranges. A mean over them has a smaller variance than one over
        independent draws.
        """
        return self._at_quantiles(latin_hypercube(count, self.dimension, rng))

    def to_contexts(self, cube: ArrayLike) -> Array:
        """Map points (n, d) of the unit cube to contexts (n, d), linearly between the bounds.

        Coordinates outside [0, 1] are clipped; a discrete variable takes its nearest possible
        value.
        """
        points = np.clip(self._rows(cube, "cube"), 0.0, 1.0)
        return self.clip(self.lower + points * (self.upper - self.lower))

    def to_cube(self, contexts: ArrayLike) -> Array:
        """Map contexts (n, d) to points (n, d) of the unit cube."""
        rows = self._rows(contexts, "contexts")
        cube: Array = (rows - self.lower) / (self.upper - self.lower)
        return np.clip(cube, 0.0, 1.0)

    def cube_of(self, contexts: Sequence[Mapping[str, float]]) -> Array:
        """Map n contexts, by the names of their variables, to points (n, d) of the unit cube."""
        rows = [[context[name] for name in self.names] for context in contexts]
        return self.to_cube(np.array(rows).reshape(len(rows), self.dimension))

    def clip(self, contexts: ArrayLike) -> Array:
        """Return the nearest possible contexts (n, d) for `contexts` (n, d)."""
        rows = self._rows(contexts, "contexts").copy()
        for column, item in enumerate(self.distributions):
            rows[:, column] = item.clip(rows[:, column])
        return rows

    def to_dict(self, context: ArrayLike) -> dict[str, float]:
        """Return one context (d,) as values by name."""
        row = self._rows(np.asarray(context, dtype=np.float64)[None], "context")[0]
        return dict(zip(self.names, row.tolist(), strict=True))

    def corners(self) -> Array:
        """Return corners of the unit cube, shape (m, d).

        Beyond `MOST_CORNER_DIMENSIONS`, of the leading ones, with the others halfway.
        """
        axes = [[0.0, 1.0]] * min(self.dimension, MOST_CORNER_DIMENSIONS)
        points = np.full((2 ** len(axes), self.dimension), 0.5)
        if not axes:
            return points
        points[:, : len(axes)] = np.array(np.meshgrid(*axes)).reshape(len(axes), -1).T
        return points

    def candidates(self, known: Sequence[Mapping[str, float]] = ()) -> Array:
        """Return possible contexts of the unit cube over which a worst case is taken, (m, d).

        The corners, a Latin hypercube that is the same in every call, then those that are `known`
        as far as they differ from all before.
        """
        inside = latin_hypercube(CANDIDATES, self.dimension, np.random.default_rng(0))
        found = self.to_cube(self.to_contexts(np.vstack([self.corners(), inside])))
        for row in self.cube_of(known):
            if (np.abs(found - row) > DISTINCT).any(axis=1).all():
                found = np.vstack([found, row])
        return found

    def _at_quantiles(self, probability: Array) -> Array:
        """Return the contexts at the quantiles of each variable, both of shape (n, d)."""
        contexts = np.empty_like(probability)
        for column, item in enumerate(self.distributions):
            contexts[:, column] = item.ppf(probability[:, column])
        return contexts

    def _rows(self, values: ArrayLike, name: str) -> Array:
        rows = np.asarray(values, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.dimension:
            raise ParameterError(
                f"{name}: expected rows of {self.dimension} values, found shape {rows.shape}"
            )
        if not np.all(np.isfinite(rows)):
            raise ParameterError(f"{name}: expected finite values")
        return rows
