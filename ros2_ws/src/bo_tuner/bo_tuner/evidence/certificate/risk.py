"""A mean with its uncertainty, and the mean of the worst values.

References
----------
Rockafellar and Uryasev (2000). Optimization of conditional value-at-risk. Journal of Risk 2(3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan, sqrt
from typing import Annotated

import numpy as np

from bo_tuner.codec.rules import Null
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.sequential import mean_bounds
from bo_tuner.study.limit_kinds.limited import UPPER


@dataclass(frozen=True)
class Mean:
    """A sample mean with its uncertainty.

    Attributes
    ----------
    value
        Mean of the sample.
    standard_error
        Of `value`; NaN for fewer than two values.
    upper, lower
        Confidence bounds of the true mean, each for itself, see `sequential.mean_bounds`; infinite
        for too few values.
    """

    value: float
    standard_error: float
    upper: Annotated[float, Null(inf)]
    lower: Annotated[float, Null(-inf)]

    def bound(self, side: str) -> float:
        """Return the bound on a side, ``upper`` or ``lower``."""
        return self.upper if side == UPPER else self.lower


def mean_of(values: Sequence[float] | Array, confidence: float) -> Mean:
    """Return the mean of independent values, its standard error and its confidence bounds."""
    sample = np.asarray(values, dtype=np.float64)
    count = len(sample)
    if count < 2:
        return Mean(float(sample[0]) if count else nan, nan, upper=inf, lower=-inf)
    return Mean(
        value=float(sample.mean()),
        standard_error=float(sample.std(ddof=1)) / sqrt(count),
        upper=float(mean_bounds(sample, confidence)[-1]),
        lower=-float(mean_bounds(-sample, confidence)[-1]),
    )


def conditional_value_at_risk(values: Sequence[float] | Array, level: float) -> float:
    """Return the mean of the largest values, a fraction 1 - level of the sample.

    If that is not a whole number of values, the smallest of them has a fractional weight
    (Rockafellar and Uryasev 2000, for a discrete distribution).
    """
    sample = np.sort(np.asarray(values, dtype=np.float64))[::-1]
    if not len(sample):
        return float("nan")
    size = (1.0 - level) * len(sample)
    weights = np.clip(size - np.arange(len(sample)), 0.0, 1.0)
    return float(weights @ sample / size)
