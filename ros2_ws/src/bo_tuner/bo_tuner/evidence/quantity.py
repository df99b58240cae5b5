"""A number of a result, of the default and of the tuned parameter set."""

from dataclasses import dataclass
from math import isfinite, isnan, nan

from bo_tuner.evidence.differences import Change, Difference
from bo_tuner.evidence.estimates import Estimate
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.text import shown, shown_beside


@dataclass(frozen=True)
class OnRecord:
    """The value of all test runs on record that is farthest on the side of a limit."""

    runs: int
    value: float


@dataclass(frozen=True)
class ViolationBound:
    """Upper bounds of the probability that a run violates a limit, by a certificate.

    Attributes
    ----------
    violations, draws
        Number of drawn runs beyond the limit, and of all.
    bound
        Of the probability in drawn contexts.
    worst, allowed
        The largest one in a worst context, and what is allowed there; NaN if no such limit holds.
    confidence
        Of each bound.
    """

    violations: int
    draws: int
    bound: float
    worst: float
    allowed: float
    confidence: float


@dataclass(frozen=True)
class DrawsOf:
    """How many draws the numbers of the default and of the tuned set are from, and both."""

    default: int
    tuned: int
    both: int | None = None


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number of the default and of the tuned parameter set.

    Attributes
    ----------
    label
        What it is, such as ``mean tracking_error``.
    metric, title, unit
        Name of its metric, what screens call that, and the unit.
    default, tuned
        The values; NaN if not known.
    estimates
        What they are the values of, if they are means over draws; else None.
    difference
        Their difference, with an interval unless the values are single extremes.
    change
        What kind of difference that is.
    limit
        Limit of the study, upper or lower; NaN without one.
    bound
        Confidence bound of the tuned value on the side of the limit, by a certificate; NaN without
        one.
    on_record, violation
        What else is known of a limit; None if nothing is.
    default_unsearched
        Whether the default has no certified worst case beside that of the tuned set.
    draws
        How many draws each number is from; None if they are from the same ones.
    objective
        Whether it is the mean of an objective.
    constraint
        Name of the constraint that the limit is of; empty without one.
    limit_verdict, default_limit_verdict
        What was found of the limit for the tuned parameter set and for the default; None without a
        limit, or for a default of which nothing is known.
    """

    label: str
    metric: str
    title: str
    unit: str
    default: float
    tuned: float
    difference: Difference | None
    change: Change
    limit: float = nan
    bound: float = nan
    on_record: OnRecord | None = None
    violation: ViolationBound | None = None
    default_unsearched: bool = False
    estimates: tuple[Estimate, Estimate] | None = None
    draws: DrawsOf | None = None
    objective: bool = False
    constraint: str = ""
    limit_verdict: LimitVerdict | None = None
    default_limit_verdict: LimitVerdict | None = None

    @property
    def values_in_words(self) -> tuple[str, str]:
        """The values of the default and of the tuned parameter set, beside the limit if any."""
        limit = self.limit
        if isnan(limit):
            return shown(self.default), shown(self.tuned)
        return shown_beside(self.default, limit), shown_beside(self.tuned, limit)

    @property
    def limit_in_words(self) -> str:
        """The limit; empty if there is none."""
        return "" if isnan(self.limit) else f"{self.limit:g}"

    @property
    def percent(self) -> float:
        """The difference in percent of the default; NaN unless that is positive and both known."""
        if not (self.default > 0.0 and isfinite(self.tuned)):
            return nan
        return 100.0 * (self.tuned / self.default - 1.0)
