"""What somebody believes of the best value of a parameter, as a distribution."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.special import ndtr

from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import Expected
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parameter_scale import factor_in


@dataclass(frozen=True, kw_only=True)
class Prior(Section):
    """Where the best value of a tuned number is believed to be.

    A normal distribution between the bounds, of the number itself, or of its logarithm.

    Attributes
    ----------
    around : float
        The most probable value.
    within : float or str
        How far off the best value may well be: a standard deviation, or a factor such as ``1.5x``,
        for a standard deviation of the logarithm.
    """

    around: float
    within: Annotated[float | str, Expected("a number, or a factor such as 1.5x")]

    def __post_init__(self) -> None:
        """Check the fields; the bounds are checked by the parameter."""
        super().__post_init__()
        if isinstance(self.within, str):
            factor_in(self.within, "within")
        elif not self.within > 0.0:
            raise StudyError(f"expected above 0, found {self.within:g}", ("within",))

    def check(self, lower: float, upper: float) -> None:
        """Refuse one that the bounds of its parameter do not permit.

        Raises
        ------
        StudyError
            If the most probable value is outside, or a factor is of numbers that are not positive.
        """
        if not lower <= self.around <= upper:
            raise StudyError(
                f"{self.around:g} lies outside the bounds [{lower}, {upper}]", ("around",)
            )
        if isinstance(self.within, str) and lower <= 0.0:
            raise StudyError("a factor needs bounds above 0", ("within",))

    def log_density(self, values: Array) -> Array:
        """Return the logarithm of the density of values (n,), 0 for the most probable one."""
        density: Array = -0.5 * ((self._of(values) - self._of(self.around)) / self._deviation) ** 2
        return density

    def log_uniform(self, lower: float, upper: float) -> float:
        """Return the logarithm of the uniform density between bounds, on the same scale."""
        ends = (self._of(np.array([lower, upper])) - self._of(self.around)) / self._deviation
        mass = float(np.diff(ndtr(ends))[0]) * math.sqrt(2.0 * math.pi)
        return math.log(mass / float(np.diff(ends)[0]))

    @property
    def _deviation(self) -> float:
        within = self.within
        return math.log(factor_in(within)) if isinstance(within, str) else float(within)

    def _of(self, values: Array | float) -> Array:
        return np.asarray(np.log(values) if isinstance(self.within, str) else values, np.float64)
