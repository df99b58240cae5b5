"""A limit on a metric: what it is on, on which side, and how often it must be kept."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from bo_tuner.errors import StudyError
from bo_tuner.study import checks

CHANCE, WORST_CASE = "chance", "worst_case"
UPPER, LOWER = "upper", "lower"
MODEL_NAMES = OBJECTIVE, OUTLIERS, FAILURES = "objective", "outliers", "failures"
"""What the models call those that are not of a constraint, whose name they have."""
EXPECTATION, SINGLE_RUN = "expectation", "single_run"
"""What a limit is on: the mean over noise, or single runs, of which a share must keep it."""


@dataclass(frozen=True, kw_only=True)
class Constraint:
    """An upper or a lower limit on a metric, or both.

    One with both becomes two constraints, ``NAME_lower`` and ``NAME_upper``, in every output.

    Attributes
    ----------
    name : str
        Name in the study.
    kind : str
        `chance`: over contexts and noise, a run keeps the limit with at least `probability`
        (Eq. 3d); `worst_case`: the limit is kept in every context, the worst one included.
    metric : str
        Metric in the study.
    upper : float, optional
        Largest permitted value, in the metric's unit, or relative to what the default has in the
        same context with the same seed, as `1.1 * default`. At least one of `upper` and `lower`.
    lower : float, optional
        Smallest permitted value, likewise. With both limits, either side may be
        violated half as often as the `probability` permits, so that both hold as often as asked.
    probability : float, optional
        Between 0 and 1. Required for a `chance` constraint. With it, in every context a run keeps
        the limit of a `worst_case` constraint with at least this probability, 0.5 or more; without
        it, in every context the mean over noise keeps the limit (Eq. 3e).
    """

    name: str
    kind: str
    metric: str
    upper: float | None = None
    lower: float | None = None
    probability: float | None = None

    def __post_init__(self) -> None:
        checks.parameter_name(self.name)
        checks.choice(self.kind, (CHANCE, WORST_CASE), "kind")
        checks.text(self.metric, "metric")
        if self.upper is None and self.lower is None:
            raise StudyError("missing; expected upper, lower or both", ("upper",))
        if self.upper is not None:
            object.__setattr__(self, "upper", checks.magnitude(self.upper, "upper"))
        if self.lower is not None:
            object.__setattr__(self, "lower", checks.magnitude(self.lower, "lower"))
            if self.upper is not None and not self.lower < self.upper:
                raise StudyError(
                    f"expected less than upper, {self.upper:g}, found {self.lower:g}", ("lower",)
                )
        if self.probability is None:
            if self.kind == CHANCE:
                raise StudyError(
                    "missing; a chance constraint needs one, such as 0.96", ("probability",)
                )
            return
        probability = checks.fraction(self.probability, "probability")
        if self.kind == WORST_CASE and probability < 0.5:
            raise StudyError(
                f"expected at least 0.5 of a worst_case constraint, found {probability:g}",
                ("probability",),
            )
        object.__setattr__(self, "probability", probability)

    def sides(self) -> tuple["Constraint", ...]:
        """Return constraints of one limit each that together imply this one.

        With both limits, either side gets half of the permitted violations: the probability of
        their union is at most the sum (Boole's inequality).
        """
        if self.lower is None or self.upper is None:
            return (self,)
        half = None if self.probability is None else 0.5 * (1.0 + self.probability)
        lower, upper = f"{self.name}_lower", f"{self.name}_upper"
        return (
            dataclasses.replace(self, name=lower, upper=None, probability=half),
            dataclasses.replace(self, name=upper, lower=None, probability=half),
        )

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
        """What the value farthest on the side of the limit is: the ``largest`` or ``smallest``."""
        return "largest" if self.sign > 0.0 else "smallest"

    @property
    def limited(self) -> str:
        """The metric that is limited, in words: the ``lowest`` one for a lower limit."""
        return self.metric if self.sign > 0.0 else f"lowest {self.metric}"

    def violations(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each of the values (...) of its metric violates the limit."""
        found: NDArray[np.bool_] = self.sign * np.asarray(values) > self.sign * self.limit
        return found

    def excess(self, value: float) -> float:
        """Return how far a value of its metric is beyond the limit, relative to the limit's size.

        Negative if it keeps the limit; not relative to a limit of 0.
        """
        return self.sign * (value - self.limit) / (abs(self.limit) or 1.0)

    def farthest(self, values: ArrayLike) -> float:
        """Return the extreme of the values (n,) of its metric, in its unit; NaN of none."""
        found = self.sign * np.asarray(values, dtype=np.float64)
        return self.sign * float(found.max()) if found.size else float("nan")

    @property
    def statistic(self) -> str:
        """What the limit is on: ``expectation`` or ``single_run``."""
        return EXPECTATION if self.probability is None else SINGLE_RUN

    @property
    def level(self) -> float:
        """Probability with which a run must keep the limit; one half for an expectation.

        A run keeps a limit at the mean of symmetric noise just as often.
        """
        return 0.5 if self.probability is None else self.probability

    @property
    def allowed(self) -> float:
        """Largest permitted probability that a run violates the limit.

        Over contexts and noise for a `chance` constraint, in any one context for a `worst_case`
        one; 1 for an expectation, which permits any.
        """
        return 1.0 if self.probability is None else 1.0 - self.probability

    @property
    def deviations(self) -> float:
        """Standard deviations between the mean of a normal metric and a limit kept so often."""
        return float(ndtri(self.level))
