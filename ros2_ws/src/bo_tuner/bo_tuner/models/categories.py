"""Choices without an order, for models of numbers.

A column of the unit cube holds the position of a choice among its m > 2 values. For the models it
becomes m columns, of which that of the value is 1 / √2 and the others are 0 (Garrido-Merchán and
Hernández-Lobato 2020). Two different values then have the squared distance 1, in whatever order
they are listed, and the squared-exponential kernel with its length scales ℓ of each column is

    k(a, b) = s² exp(-¼ (1 / ℓ_a² + 1 / ℓ_b²))   for a ≠ b,   s² for a = b,

which for equal length scales is the weighted Hamming kernel (Hutter, Hoos and Leyton-Brown 2011).

References
----------
Garrido-Merchán and Hernández-Lobato (2020). Dealing with categorical and integer-valued variables
in Bayesian optimization with Gaussian processes. Neurocomputing 380.
Hutter, Hoos and Leyton-Brown (2011). Sequential model-based optimization for general algorithm
configuration. LION 5, Section 4.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.models.compression import Compression
from bo_tuner.models.hyperpriors import Hyperpriors
from bo_tuner.models.protocol import FitModel, Model
from bo_tuner.numerics.arrays import Array


@dataclass(frozen=True)
class Coding:
    """Which columns of the unit cube are choices, and their columns in the models.

    Attributes
    ----------
    levels : tuple of int, shape (d,)
        Number of values of each choice; 0 for a number. Further columns are numbers.
    """

    levels: tuple[int, ...]

    @property
    def is_plain(self) -> bool:
        """Whether there is no choice, so that nothing is coded."""
        return not any(self.levels)

    def encode(self, x: ArrayLike) -> Array:
        """Return points (n, d) of the cube as the models take them, shape (n, D)."""
        points = np.asarray(x, dtype=np.float64)
        if self.is_plain:
            return points
        parts = []
        for column in range(points.shape[1]):
            values, levels = points[:, column], self._levels(column)
            if levels:
                chosen = np.rint(values * (levels - 1))
                parts.append((chosen[:, None] == np.arange(levels)) / np.sqrt(2.0))
            else:
                parts.append(values[:, None])
        return np.hstack(parts)

    def decode(self, x: Array) -> Array:
        """Return the points (n, d) of the cube that were encoded as x (n, D)."""
        parts = []
        for columns, levels in self._groups(x.shape[1]):
            values = x[:, columns]
            parts.append(values.argmax(axis=1) / (levels - 1) if levels else values[:, 0])
        return np.stack(parts, axis=1)

    def spread(self, values: ArrayLike) -> Array:
        """Return a number for each column of the cube, (d,), for each of the models, (D,)."""
        given = np.asarray(values, dtype=np.float64)
        counts = [self._levels(column) or 1 for column in range(len(given))]
        return np.repeat(given, counts)

    def least(self, values: Array) -> Array:
        """Return the least number among the columns of each choice: (D,) to (d,)."""
        return np.array([values[columns].min() for columns, _ in self._groups(len(values))])

    def names(self, names: Sequence[str]) -> list[str]:
        """Return names of the models' columns, for names of the cube's."""
        columns = []
        for column, name in enumerate(names):
            levels = self._levels(column)
            columns += [f"{name}.{level}" for level in range(levels)] if levels else [name]
        return columns

    def _levels(self, column: int) -> int:
        return self.levels[column] if column < len(self.levels) else 0

    def _groups(self, width: int) -> list[tuple[slice, int]]:
        groups, begin, column = [], 0, 0
        while begin < width:
            levels = self._levels(column)
            groups.append((slice(begin, begin + (levels or 1)), levels))
            begin, column = begin + (levels or 1), column + 1
        return groups


@dataclass(frozen=True, eq=False)
class CodedModel:
    """A model of encoded points, over the unit cube; see `Model`.

    Attributes
    ----------
    inner
        The model of encoded points.
    coding
        Encodes them.
    """

    inner: Model
    coding: Coding

    @property
    def points(self) -> Array:  # noqa: D102
        return self.coding.decode(self.inner.points)

    @property
    def counts(self) -> Array:  # noqa: D102
        return self.inner.counts

    @property
    def length_scales(self) -> Array:  # noqa: D102
        return self.coding.least(self.inner.length_scales)

    @property
    def scale(self) -> float:  # noqa: D102
        return self.inner.scale

    @property
    def noise_variance(self) -> float:  # noqa: D102
        return self.inner.noise_variance

    @property
    def compression(self) -> Compression:  # noqa: D102
        return self.inner.compression

    @property
    def warm_start(self) -> tuple[float, ...]:  # noqa: D102
        return self.inner.warm_start

    @property
    def warnings(self) -> tuple[str, ...]:  # noqa: D102
        return self.inner.warnings

    def predict(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the latent response at x (m, d)."""
        return self.inner.predict(self.coding.encode(x))

    def predict_mean(self, x: ArrayLike) -> Array:
        """Return the mean (m,) alone at x (m, d)."""
        return self.inner.predict_mean(self.coding.encode(x))

    def predict_reinterpolated(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return mean and variance (m,) of the noise-free model; the variance is 0 at `points`."""
        return self.inner.predict_reinterpolated(self.coding.encode(x))


def coded(model: Model, coding: Coding) -> Model:
    """Return a model of encoded points as one over the unit cube."""
    return model if coding.is_plain else CodedModel(model, coding)


def coded_fit(fit: FitModel, coding: Coding) -> FitModel:
    """Return a fit to points of the unit cube, for one to encoded points."""

    def fit_coded(
        x: ArrayLike,
        y: ArrayLike,
        *,
        rng: np.random.Generator,
        minimum_length_scales: ArrayLike | None = None,
        start: Sequence[float] | None = None,
        keep: bool = False,
        priors: Hyperpriors | None = None,
    ) -> Model:
        minimum = None if minimum_length_scales is None else coding.spread(minimum_length_scales)
        points = coding.encode(x)
        inner = fit(
            points,
            y,
            rng=rng,
            minimum_length_scales=minimum,
            start=start,
            keep=keep,
            priors=priors,
        )
        return coded(inner, coding)

    return fit if coding.is_plain else fit_coded
