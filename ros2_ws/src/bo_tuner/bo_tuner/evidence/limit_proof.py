"""What runs show of a limit: the statistics of a certificate, for each kind of limit.

What limits on single runs have in common, and limits on a mean; `proof_of` has that of a limit. A
kind of somebody else's has that of the one that it is derived from, unless it registers its own.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Protocol

import numpy as np

from bo_tuner.evidence.reasons import Reason, Why
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.mean_tests import (
    Betting,
    MeanTest,
    NormalOrSkewed,
    is_mean_shown,
    mean_bound,
)
from bo_tuner.numerics.sequential import (
    draws_needed,
    is_hopeless,
    is_mean_refuted,
    is_refuted,
    is_shown,
)
from bo_tuner.numerics.two_kinds import gap
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.base import LimitKind
from bo_tuner.study.limit_kinds.on_mean import OnMean
from bo_tuner.study.limit_kinds.on_runs import OnRuns


class BoundedMean(Protocol):
    """A mean over noise with its confidence bounds."""

    def bound(self, side: str) -> float:
        """Return the bound on a side, ``upper`` or ``lower``."""


class InContext(Protocol):
    """What runs in one context have shown."""

    @property
    def mean(self) -> BoundedMean:
        """Mean over noise."""

    @property
    def needs_range(self) -> bool:
        """Whether only a range of the metric would bound the mean, as runs are of two kinds."""

    @property
    def violation_bound(self) -> float:
        """Upper confidence bound of the probability of a violation."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of one parameter set, in draws of the context or in a single one.

    Attributes
    ----------
    events
        Whether each violates the limit or failed.
    values : ndarray, shape (n,)
        The metric in the complete ones.
    farthest
        Value farthest on the side of the limit in all runs of the parameter set that are known;
        NaN of none.
    declared
        Smallest and largest value that any run can have; None if that is not known.
    exact
        Whether one run decides: they are of a simulator without noise, and of one context, or each
        of a context in which the limit must be kept.
    """

    events: Sequence[bool]
    values: Array
    farthest: float = float("nan")
    declared: tuple[float, float] | None = None
    exact: bool = False


class Proof(ABC):
    """What runs show of a limit, whose kind is the `rule`."""

    def __init__(self, rule: LimitKind) -> None:
        self.rule, self.limited = rule, rule.limited

    @abstractmethod
    def fewest(self, declared: tuple[float, float] | None, confidence: float) -> int:
        """Return the least number of runs in a context that show it, by the range of the metric."""

    def assumes_noise(self, declared: tuple[float, float] | None) -> bool:
        """Return whether runs show the limit only if no rare ones are far beyond the others."""
        return False

    @abstractmethod
    def is_shown(self, runs: Runs, confidence: float) -> bool:
        """Return whether runs of a certificate show the limit; valid however often it is asked."""

    @abstractmethod
    def is_refuted(self, runs: Runs, confidence: float) -> bool:
        """Return whether the runs refute the limit."""

    @abstractmethod
    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:
        """Return whether the runs, continued to `most` of them, cannot show the limit any more."""

    def needs_range(self, runs: Runs) -> bool:
        """Return whether the runs can show the limit only if their metric declares a range."""
        return False

    @abstractmethod
    def by_draws(self, runs: Runs, confidence: float) -> Reason:
        """Return why draws of a certificate show the limit, or do not."""

    @abstractmethod
    def in_contexts(self, worst: Sequence[InContext], refuting: Sequence[InContext]) -> Reason:
        """Return why runs in the worst contexts show the limit, or do not.

        Parameters
        ----------
        worst
            The contexts that may be the worst, by their mean, the worst one first.
        refuting
            Those that refute the limit.
        """

    @abstractmethod
    def together(self, runs: Runs) -> float:
        """Return the limited quantity of all runs taken together; NaN of none."""

    @abstractmethod
    def contradicts(self, together: float) -> bool:
        """Return whether the quantity that `together` returned is beyond the limit."""


class ProofByRuns(Proof):
    """Of a limit that a share of single runs must keep."""

    def fewest(  # noqa: D102
        self, declared: tuple[float, float] | None, confidence: float
    ) -> int:
        return draws_needed(self.rule.allowed, confidence)

    def is_shown(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        return is_shown(runs.events, self.rule.allowed, confidence)

    def is_refuted(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        return is_refuted(runs.events, self.rule.allowed, confidence)

    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:  # noqa: D102
        return is_hopeless(runs.events, most, self.rule.allowed, confidence)

    def by_draws(self, runs: Runs, confidence: float) -> Reason:  # noqa: D102
        return Reason(Why.SHARE, needed=draws_needed(self.rule.allowed, confidence))

    def in_contexts(  # noqa: D102
        self, worst: Sequence[InContext], refuting: Sequence[InContext]
    ) -> Reason:
        likeliest = max(worst, key=lambda context: context.violation_bound)
        return Reason(Why.SHARE_IN_CONTEXT, place=_place(likeliest, worst))

    def together(self, runs: Runs) -> float:
        """Return the share of runs beyond the limit or failed."""
        return float(np.mean(runs.events))

    def contradicts(self, together: float) -> bool:  # noqa: D102
        return together > self.rule.allowed


class ProofByMean(Proof):
    """Of a limit that the mean over noise keeps; single runs may be beyond it."""

    def fewest(  # noqa: D102
        self, declared: tuple[float, float] | None, confidence: float
    ) -> int:
        return self._test(declared).fewest(self.limited.sign * self.limited.limit, confidence)

    def assumes_noise(self, declared: tuple[float, float] | None) -> bool:  # noqa: D102
        return declared is None

    def is_shown(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        sign, test = self.limited.sign, self._test(runs.declared, runs.farthest)
        return is_mean_shown(sign * runs.values, sign * self.limited.limit, confidence, test)

    def bound(self, runs: Runs, confidence: float) -> float:
        """Return the confidence bound of the mean on the side of the limit."""
        sign, test = self.limited.sign, self._test(runs.declared, runs.farthest)
        return sign * mean_bound(sign * runs.values, confidence, test)

    def _test(self, declared: tuple[float, float] | None, farthest: float = math.nan) -> MeanTest:
        """Return the test that a mean is within an upper limit; a lower limit is mirrored."""
        if declared is None:
            return NormalOrSkewed(
                -math.inf if math.isnan(farthest) else self.limited.sign * farthest
            )
        low, high = declared
        return Betting(low, high) if self.limited.sign > 0.0 else Betting(-high, -low)

    def is_refuted(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        sign = self.limited.sign
        return is_mean_refuted(sign * runs.values, sign * self.limited.limit, confidence)

    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:
        """Return whether they refute it, or need a range: else more can move the mean anywhere."""
        return self.is_refuted(runs, confidence) or self.needs_range(runs)

    def needs_range(self, runs: Runs) -> bool:
        """Return whether runs without a range are of two kinds: no test then bounds their mean."""
        return runs.declared is None and gap(runs.values) is not None

    def by_draws(self, runs: Runs, confidence: float) -> Reason:  # noqa: D102
        if self.needs_range(runs):
            return Reason(Why.TWO_KINDS)
        return Reason(Why.MEAN, bound=self.bound(runs, confidence))

    def in_contexts(self, worst: Sequence[InContext], refuting: Sequence[InContext]) -> Reason:
        """Return it by the bound: the largest mean need not have the largest bound."""
        sign, side = self.limited.sign, self.limited.side
        top = max(worst, key=lambda context: sign * context.mean.bound(side))
        mixed = [context for context in worst if context.needs_range]
        why, by = Why.MEAN_IN_CONTEXT, top
        if refuting and not np.isfinite(top.mean.bound(side)):
            # A refutation ends the evaluations before there are enough runs for a bound.
            why, by = Why.REFUTED_IN_CONTEXT, refuting[0]
        elif mixed:
            why, by = Why.TWO_KINDS_IN_CONTEXT, mixed[0]
        return Reason(why, place=_place(by, worst))

    def together(self, runs: Runs) -> float:
        """Return the mean of the values; NaN of none."""
        return float(runs.values.mean()) if len(runs.values) else float("nan")

    def contradicts(self, together: float) -> bool:  # noqa: D102
        return bool(self.limited.violations(together))


def _place(one: InContext, worst: Sequence[InContext]) -> int:
    return next(place for place, context in enumerate(worst) if context is one)


@singledispatch
def proof_of_kind(rule: LimitKind) -> Proof:
    """Return what runs show of a limit, by the class of its kind."""
    raise TypeError(f"no proof of a limit of the kind {type(rule).__name__}")


proof_of_kind.register(OnRuns, ProofByRuns)
proof_of_kind.register(OnMean, ProofByMean)


def proof_of(constraint: Constraint) -> Proof:
    """Return what runs show of a limit."""
    return proof_of_kind(constraint.rule)
