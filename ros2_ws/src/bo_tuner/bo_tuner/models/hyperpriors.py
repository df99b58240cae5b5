"""Hyperparameters of the Gaussian process and their log-normal hyper-priors.

All values are in scaled units: inputs in the unit cube, responses of zero mean and unit standard
deviation. Hyperparameters are estimated on the logarithmic scale: with φ = log θ the prior of each
φ is normal, and the maximum a posteriori is taken over φ. (The mode depends on the scale; over φ
the mode of the prior is the median of θ, over θ itself it would lie lower.)
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array

NUGGET = 1e-4
"""Least noise, in standardized responses; it keeps covariances of exact ones well conditioned."""


@dataclass(frozen=True)
class LogNormal:
    """Log-normal density, and bounds of the estimate.

    Attributes
    ----------
    median : float
        Median of the variable.
    spread : float
        Standard deviation of its natural logarithm.
    lower, upper : float
        Box bounds of the estimate.
    """

    median: float
    spread: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        """Reject values that define no density."""
        if not 0.0 < self.lower <= self.median <= self.upper < np.inf:
            raise ValueError(
                "log-normal prior: expected 0 < lower <= median <= upper, found "
                f"lower {self.lower:g}, median {self.median:g}, upper {self.upper:g}"
            )
        if not 0.0 < self.spread < np.inf:
            raise ValueError(f"log-normal prior: expected spread > 0, found {self.spread:g}")


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """Hyperparameters in scaled units.

    Attributes
    ----------
    length_scales : ndarray, shape (d,)
        Length scale of the kernel in each dimension, in edges of the unit cube.
    signal : float
        Standard deviation of the process about its mean, in standardized responses.
    noise : float
        Standard deviation of one observation's noise, in standardized responses.
    """

    length_scales: Array
    signal: float
    noise: float

    @classmethod
    def from_log(cls, phi: Array) -> Self:
        """Build from φ = (log ℓ_1, …, log ℓ_d, log signal, log noise), shape (d + 2,)."""
        theta = np.exp(phi)
        return cls(theta[:-2], float(theta[-2]), float(theta[-1]))

    def to_log(self) -> Array:
        """Return φ, shape (d + 2,)."""
        phi: Array = np.log(np.concatenate([self.length_scales, [self.signal, self.noise]]))
        return phi


@dataclass(frozen=True, eq=False)
class Hyperpriors:
    """Independent priors of all hyperparameters.

    Attributes
    ----------
    length_scale : LogNormal
        Prior of each length scale, in edges of the unit cube.
    signal : LogNormal
        Prior of the signal standard deviation, in standardized responses.
    noise : LogNormal
        Prior of the noise standard deviation, in standardized responses.
    """

    length_scale: LogNormal
    signal: LogNormal
    noise: LogNormal

    @classmethod
    def noiseless(cls, dimension: int) -> Self:
        """Return the default priors with the noise fixed at a nugget, its least value.

        For responses that are known to be exact.
        """
        priors = cls.default(dimension)
        return replace(priors, noise=LogNormal(NUGGET, 1.0, NUGGET, NUGGET))

    @classmethod
    def default(cls, dimension: int) -> Self:
        """Return the default priors for inputs of dimension d.

        - Length scale: median 0.5 √d, because the typical distance of two points in the unit cube
          grows with √d (Hvarfner, Hellsten and Nardi 2024); a factor of e either way is one
          standard deviation. Lower bound 0.01: finer structure cannot be learnt from the few
          hundred points of a study. Upper bound 20, of the median too: the response is then linear
          in the cube.
        - Signal: median 1 (the responses are standardized); long length scales need more.
        - Noise: median 0.1 with a wide spread, because replicates determine it well. Its lower
          bound is the `NUGGET`.
        """
        return cls(
            length_scale=LogNormal(min(0.5 * dimension**0.5, 20.0), 1.0, 0.01, 20.0),
            signal=LogNormal(1.0, 1.0, 0.05, 20.0),
            noise=LogNormal(0.1, 1.5, NUGGET, 3.0),
        )

    def _each(self, dimension: int) -> list[LogNormal]:
        return [self.length_scale] * dimension + [self.signal, self.noise]

    def medians(self, dimension: int) -> Array:
        """Return the medians as φ, shape (d + 2,)."""
        return np.log([prior.median for prior in self._each(dimension)])

    def spreads(self, dimension: int) -> Array:
        """Return the standard deviations of φ, shape (d + 2,)."""
        return np.array([prior.spread for prior in self._each(dimension)])

    def bounds(self, dimension: int, minimum_length_scales: ArrayLike | None = None) -> Array:
        """Return the box (d + 2, 2) of φ.

        The `minimum_length_scales` (d,), in edges of the unit cube, take the place of lower bounds
        of the prior.

        Raises
        ------
        ValueError
            If `minimum_length_scales` has another shape, or an entry that is negative or NaN.
        """
        box = np.log([[prior.lower, prior.upper] for prior in self._each(dimension)])
        if minimum_length_scales is not None:
            minimum = np.asarray(minimum_length_scales, dtype=np.float64)
            if minimum.shape != (dimension,):
                raise ValueError(
                    f"minimum_length_scales: expected shape ({dimension},), found {minimum.shape}"
                )
            if not ((minimum >= 0.0) & np.isfinite(minimum)).all():
                raise ValueError(
                    f"minimum_length_scales: expected finite values >= 0, found {minimum}"
                )
            lower = np.log(np.maximum(minimum, self.length_scale.lower))
            box[:dimension, 0] = lower
            box[:dimension, 1] = np.maximum(box[:dimension, 1], lower)
        return box

    def log_density(self, phi: Array) -> tuple[float, Array]:
        """Return the log density of φ and its gradient (d + 2,); the box is ignored."""
        dimension = len(phi) - 2
        spreads = self.spreads(dimension)
        z = (phi - self.medians(dimension)) / spreads
        value = -0.5 * z @ z - np.log(spreads).sum() - 0.5 * len(phi) * np.log(2.0 * np.pi)
        return float(value), -z / spreads

    def draw(self, dimension: int, rng: np.random.Generator) -> Array:
        """Draw one φ, shape (d + 2,), from the priors; the box is ignored."""
        return rng.normal(self.medians(dimension), self.spreads(dimension))
