"""The scales of tuned numbers: how the optimizer sees a value v between its bounds.

linear
    v itself.
log
    log v, for a positive parameter of which ratios matter.
symlog
    log(1 + v / v₀), for a parameter from 0 on: like the logarithm well above v₀, which is a
    thousandth of the upper bound, and linear below it, down to 0.
"""

import math
import re

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array

LINEAR, LOG, SYMLOG = "linear", "log", "symlog"

SCALES = (LINEAR, LOG, SYMLOG)

FACTOR = re.compile(r"([0-9]+(?:\.[0-9]*)?)\s?x")

DECADES = 1000.0
"""Upper bound over v₀: the symlog scale is logarithmic over three decades, and linear down to 0."""


def scaled(scale: str, values: ArrayLike, upper: Array) -> Array:
    """Return s(v) of values (..., k) of parameters with the upper bounds `upper` (k,)."""
    v = np.asarray(values, dtype=np.float64)
    if scale == LOG:
        return np.log(v)
    return np.log1p(v * (DECADES / upper)) if scale == SYMLOG else v


def unscaled(scale: str, positions: ArrayLike, upper: Array) -> Array:
    """Return v for s(v) of shape (..., k)."""
    s = np.asarray(positions, dtype=np.float64)
    if scale == LOG:
        return np.exp(s)
    return np.expm1(s) * (upper / DECADES) if scale == SYMLOG else s


def places_at(scale: str, value: float, upper: float, places: int) -> int:
    """Return the decimal place of a value v that is as fine as one of s(v).

    A step of s(v) is at least as large as one of v on the linear scale, of v divided by v on the
    logarithmic one, and by the larger of v and v₀ on the other.
    """
    if scale == LINEAR:
        return places
    size = max(value, upper / DECADES) if scale == SYMLOG else value
    return places - math.floor(math.log10(size))


def factor_in(text: str, *path: str | int) -> float:
    """Return the factor that a text such as ``1.5x`` is.

    Raises
    ------
    StudyError
        If it is none above 1.
    """
    match = FACTOR.fullmatch(text)
    if match is None or not float(match[1]) > 1.0:
        expected = "a number, or a factor above 1 such as 2x"
        raise StudyError(f"expected {expected}, found {checks.show(text)}", path)
    return float(match[1])
