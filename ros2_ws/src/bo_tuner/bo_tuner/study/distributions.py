"""Distributions of a context variable, all with bounded support.

Bounded, because over an unbounded context there may be no worst case. Each distribution is a frozen
class; its fields are the keys of the study file.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import FRACTION, POSITIVE, Expected
from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.trials import Value

# Placeholder for a nominal value that was not given; `__post_init__` replaces it.
_DEFAULT: Any = None


class Distribution(Section, ABC):
    """A distribution with bounded support.

    Attributes
    ----------
    nominal : float
        The value that the design of the controller assumes.
    """

    kind: ClassVar[str]
    nominal: Value

    @property
    def labels(self) -> tuple[bool | str, ...]:
        """The values, if they are no numbers; a label is numbered by its position."""
        return ()

    def number(self, value: Value) -> float:
        """Return the number that stands for a value, which is itself unless it is a label.

        Raises
        ------
        ParameterError
            If it is no label, or no number.
        """
        if self.labels:
            # Not `value in self.labels`, which would take 1 for true.
            for position, label in enumerate(self.labels):
                if checks.same_value(label, value):
                    return float(position)
            known = ", ".join(map(checks.show, self.labels))
            raise ParameterError(f"expected one of {known}, found {checks.show(value)}")
        if isinstance(value, (bool, str)):
            raise ParameterError(f"expected a number, found {checks.show(value)}")
        return float(value)

    def value(self, number: float) -> Value:
        """Return the value that a possible number stands for."""
        return self.labels[int(number)] if self.labels else float(number)

    @property
    @abstractmethod
    def lower(self) -> float:
        """Lower end of the support."""

    @property
    @abstractmethod
    def upper(self) -> float:
        """Upper end of the support."""

    @abstractmethod
    def _quantile(self, probability: Array) -> Array: ...

    def ppf(self, probability: ArrayLike) -> Array:
        """Return quantiles, the inverse of the cumulative distribution function, shape (...).

        They are in the variable's unit, and never outside the support.

        Raises
        ------
        ParameterError
            If a probability, shape (...), lies outside [0, 1].
        """
        q = np.asarray(probability, dtype=np.float64)
        if not np.all((q >= 0.0) & (q <= 1.0)):
            raise ParameterError("probability: expected values in [0, 1]")
        with np.errstate(all="ignore"):
            quantiles = np.asarray(self._quantile(q), dtype=np.float64)
        return np.clip(quantiles, self.lower, self.upper)

    def integers(self, probability: ArrayLike) -> Array:
        """Return the nearest integers of the quantiles at `probability`, shape (...)."""
        return np.rint(self.ppf(probability))

    def clip(self, values: ArrayLike) -> Array:
        """Return the nearest value of the support for each of `values`, shape (...)."""
        return np.clip(np.asarray(values, dtype=np.float64), self.lower, self.upper)


Number = Annotated[float, checks.magnitude]
Positive = Annotated[float, checks.magnitude, POSITIVE]


def _with_room(ends: tuple[float, float]) -> tuple[float, float]:
    checks.check_width(*ends, instead="a context needs room to vary")
    return ends


@dataclass(frozen=True, kw_only=True)
class _Continuous(Distribution):
    """Base of the continuous distributions: an interval and a nominal value in it.

    Attributes
    ----------
    bounds : tuple of float
        Smallest and largest value.
    """

    bounds: Annotated[tuple[Number, Number], Expected("bounds [lower, upper]"), _with_room]
    nominal: Number = _DEFAULT

    @property
    def lower(self) -> float:
        """Lower bound."""
        return self.bounds[0]

    @property
    def upper(self) -> float:
        """Upper bound."""
        return self.bounds[1]

    @property
    def width(self) -> float:
        """Length of the support."""
        return self.upper - self.lower

    def _finish(self, default_nominal: float) -> None:
        if self.nominal is None:
            nominal = float(np.clip(default_nominal, self.lower, self.upper))
        else:
            nominal = self.nominal
            self._check_inside(nominal, "nominal")
        object.__setattr__(self, "nominal", nominal)
        with np.errstate(all="ignore"):
            quantiles = self._quantile(np.array([0.0, 0.1, 0.5, 0.9, 1.0]))
        slack = 1e-6 * self.width
        if not np.all((quantiles >= self.lower - slack) & (quantiles <= self.upper + slack)):
            raise StudyError(f"this {self.kind} is too extreme to compute its quantiles")

    def _check_inside(self, value: float, key: str) -> None:
        if not self.lower <= value <= self.upper:
            raise StudyError(
                f"{value} lies outside the bounds [{self.lower}, {self.upper}]", (key,)
            )


@dataclass(frozen=True, kw_only=True)
class TruncatedNormal(_Continuous):
    """Normal distribution truncated at the bounds.

    The nominal value is the mean, or the bound nearest to it.

    Attributes
    ----------
    mean : float
        Mean of the normal distribution before the truncation.
    standard_deviation : float
        Its standard deviation before the truncation.
    """

    kind: ClassVar[str] = "truncated_normal"
    mean: Number
    standard_deviation: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        self._finish(self.mean)

    def _quantile(self, probability: Array) -> Array:
        # This module is slow to import, and no other distribution needs it.
        from scipy import stats

        low, high = (
            (np.float64(bound) - self.mean) / self.standard_deviation for bound in self.bounds
        )
        return cast(
            Array,
            stats.truncnorm.ppf(
                probability, low, high, loc=self.mean, scale=self.standard_deviation
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Uniform(_Continuous):
    """Uniform distribution between the bounds; the nominal value is the middle."""

    kind: ClassVar[str] = "uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._finish(self.lower + 0.5 * self.width)

    def integers(self, probability: ArrayLike) -> Array:
        """Return integers of which all are equally probable, also the outermost, shape (...)."""
        steps = np.floor(np.asarray(probability, dtype=np.float64) * (self.width + 1.0))
        return self.clip(self.lower + steps)

    def _quantile(self, probability: Array) -> Array:
        return probability * self.width + self.lower


@dataclass(frozen=True, kw_only=True)
class Beta(_Continuous):
    """Beta distribution with shapes `a` and `b`, stretched from [0, 1] to the bounds.

    The nominal value is its mean.

    Attributes
    ----------
    a : float
        First shape, above 0; the larger it is, the more the values lie at the upper bound.
    b : float
        Second shape, above 0; the larger it is, the more the values lie at the lower bound.
    """

    kind: ClassVar[str] = "beta"
    a: Positive
    b: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        # Written so that no overflow of a + b or b / a of extreme shapes raises an error.
        with np.errstate(all="ignore"):
            mean = 1.0 / (1.0 + np.float64(self.b) / np.float64(self.a))
        self._finish(self.lower + float(mean) * self.width)

    def _quantile(self, probability: Array) -> Array:
        return cast(Array, betaincinv(self.a, self.b, probability) * self.width + self.lower)


@dataclass(frozen=True, kw_only=True)
class Triangular(_Continuous):
    """Triangular distribution between the bounds; the nominal value is its mode.

    Attributes
    ----------
    mode : float
        Most probable value.
    """

    kind: ClassVar[str] = "triangular"
    mode: Number

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_inside(self.mode, "mode")
        self._finish(self.mode)

    def _quantile(self, probability: Array) -> Array:
        peak = np.clip((self.mode - self.lower) / self.width, 0.0, 1.0)
        rising = np.sqrt(peak * probability)
        falling = 1.0 - np.sqrt((1.0 - peak) * (1.0 - probability))
        return cast(Array, np.where(probability < peak, rising, falling) * self.width + self.lower)


def _different(items: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return the values of a discrete variable: floats that increase, or different labels."""
    if len(items) < 2:
        raise StudyError(f"expected at least two values, found {len(items)}")
    for kind in (bool, str):
        labels = [item for item in items if isinstance(item, kind)]
        if not labels:
            continue
        if len(labels) < len(items):
            raise StudyError("expected values of one type")
        if len(set(labels)) < len(labels):
            raise StudyError("expected different values")
        checks.at_most(labels, maxima.CHOICES)
        return tuple(labels)
    values = tuple(checks.magnitude(item, index) for index, item in enumerate(items))
    if any(left >= right for left, right in pairwise(values)):
        raise StudyError("expected strictly increasing values")
    return values


Values = Annotated[tuple[Value, ...], Expected("a list of values"), _different]


@dataclass(frozen=True, kw_only=True)
class Discrete(Distribution):
    """Finitely many `values`, strictly increasing, each with its probability.

    The nominal value is the most probable one, or the first of several such values.

    Attributes
    ----------
    values : tuple of float, bool or str
        The values: numbers that increase, or truth values or texts in any order.
    probabilities : tuple of float
        Their probabilities, of sum 1; equal ones unless given.
    """

    kind: ClassVar[str] = "discrete"
    values: Values
    probabilities: Annotated[tuple[Number, ...], Expected("a list of numbers")] = ()
    nominal: Value = _DEFAULT

    def __post_init__(self) -> None:
        super().__post_init__()
        values = self.values
        probabilities = self.probabilities or (1.0 / len(values),) * len(values)
        if len(probabilities) != len(values):
            raise StudyError(
                f"expected one for each of the {len(values)} values, found {len(probabilities)}",
                ("probabilities",),
            )
        for index, probability in enumerate(probabilities):
            FRACTION(probability, "probabilities", index)
        if abs(sum(probabilities) - 1.0) > 1e-9:
            raise StudyError(f"expected a sum of 1, found {sum(probabilities)}", ("probabilities",))
        nominal = values[int(np.argmax(probabilities))]
        if self.nominal is not None:
            nominal = self.nominal
            if not isinstance(values[0], (bool, str)):
                nominal = checks.magnitude(nominal, "nominal")
            if not any(checks.same_value(nominal, value) for value in values):
                raise StudyError(f"{nominal} is none of the values", ("nominal",))
        object.__setattr__(self, "probabilities", probabilities)
        object.__setattr__(self, "nominal", nominal)

    @property
    def labels(self) -> tuple[bool | str, ...]:
        """The values, if they are truth values or texts."""
        return tuple(value for value in self.values if isinstance(value, (bool, str)))

    @property
    def support(self) -> Array:
        """The numbers (k,) of the k values, strictly increasing."""
        if self.labels:
            return np.arange(len(self.labels), dtype=np.float64)
        return np.asarray(self.values, dtype=np.float64)

    @property
    def lower(self) -> float:
        """Smallest number of a value."""
        return self.number(self.values[0])

    @property
    def upper(self) -> float:
        """Largest number of a value."""
        return self.number(self.values[-1])

    def _quantile(self, probability: Array) -> Array:
        # The last value absorbs the rounding error of the sum.
        cumulative = np.cumsum(self.probabilities)[:-1]
        return self.support[np.searchsorted(cumulative, probability, side="left")]

    def clip(self, values: ArrayLike) -> Array:
        """Return the nearest of the possible values for each of `values`, shape (...)."""
        support = self.support
        middles = support[:-1] + 0.5 * np.diff(support)
        return support[np.searchsorted(middles, np.asarray(values, dtype=np.float64))]


DISTRIBUTIONS: dict[str, type[Distribution]] = {
    cls.kind: cls for cls in (TruncatedNormal, Uniform, Beta, Triangular, Discrete)
}
"""Distribution by its name in the study file."""
