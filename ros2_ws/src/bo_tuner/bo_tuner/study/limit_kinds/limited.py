"""What every limit has: a metric, an upper or a lower limit on it, and how often it is kept."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import FRACTION, KEY, Written

UPPER, LOWER = "upper", "lower"

# In a file, a limit as text is relative to the default.
Limit = Annotated[Annotated[float, checks.magnitude] | None, Written(str)]


@dataclass(frozen=True, kw_only=True)
class Limited(Section):
    """A limit of a study, without the rules of its kind.

    Attributes
    ----------
    name, kind, metric
        Name in the study, its kind, and the limited metric.
    upper, lower
        The limits, in the metric's unit; None if there is none on this side.
    probability
        With which a run must keep the limit; None if none is given.
    """

    name: Annotated[str, KEY, checks.parameter_name]
    kind: str
    metric: str
    upper: Limit = None
    lower: Limit = None
    probability: Annotated[float, FRACTION] | None = None

    @property
    def sign(self) -> float:
        """Factor that turns the metric into one with an upper limit: -1 for a lower limit."""
        return 1.0 if self.lower is None else -1.0

    @property
    def limit(self) -> float:
        """The only limit, in the metric's unit.

        Raises
        ------
        ValueError
            If there are two.
        """
        limits = [limit for limit in (self.lower, self.upper) if limit is not None]
        if len(limits) != 1:
            raise ValueError(f"constraint {self.name} has two limits, see its sides")
        return limits[0]

    @property
    def side(self) -> str:
        """Which limit it has: ``upper`` or ``lower``."""
        return UPPER if self.sign > 0.0 else LOWER

    @property
    def beyond(self) -> str:
        """Where the violating values are: ``above`` or ``below`` the limit."""
        return "above" if self.sign > 0.0 else "below"

    @property
    def extreme(self) -> str:
        """Which value is farthest on the side of the limit: the ``largest`` or ``smallest``."""
        return "largest" if self.sign > 0.0 else "smallest"

    def violations(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each of the values (...) of its metric violates the limit."""
        violated: NDArray[np.bool_] = self.sign * np.asarray(values) > self.sign * self.limit
        return violated

    def excess(self, value: float) -> float:
        """Return how far a value of its metric is beyond the limit, relative to the limit's size.

        Negative if it keeps the limit; not relative to a limit of 0.
        """
        return self.sign * (value - self.limit) / (abs(self.limit) or 1.0)

    def farthest(self, values: ArrayLike) -> float:
        """Return the extreme of the values (n,) of its metric, in its unit; NaN of none."""
        signed = self.sign * np.asarray(values, dtype=np.float64)
        return self.sign * float(signed.max()) if signed.size else float("nan")
