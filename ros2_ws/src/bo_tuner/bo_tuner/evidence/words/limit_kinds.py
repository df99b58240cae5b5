"""Sentences on a limit, for each kind of limit; `words_of` has those of a limit."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import singledispatch
from typing import Protocol

import numpy as np

from bo_tuner import text
from bo_tuner.evidence.limit_proof import ProofByMean, Runs
from bo_tuner.numerics.sequential import draws_needed, probability_bounds
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.base import LimitKind
from bo_tuner.study.limit_kinds.on_mean import OnMean
from bo_tuner.study.limit_kinds.on_runs import OnRuns


class BoundedMean(Protocol):
    """A mean over noise with its confidence bounds."""

    @property
    def value(self) -> float:
        """The mean."""

    def bound(self, side: str) -> float:
        """Return the bound on a side, ``upper`` or ``lower``."""


class InContext(Protocol):
    """What runs in one context have shown."""

    @property
    def mean(self) -> BoundedMean:
        """Mean over noise."""

    @property
    def evaluations(self) -> int:
        """Number of complete runs."""

    @property
    def beyond(self) -> int:
        """Number of those beyond the limit."""

    @property
    def needs_range(self) -> bool:
        """Whether only a range of the metric would bound the mean, as runs are of two kinds."""

    @property
    def violation_bound(self) -> float:
        """Upper confidence bound of the probability of a violation."""

    @property
    def place(self) -> str:
        """The values of the context, in words; empty if there are none."""


class Words(ABC):
    """What is said of a limit, whose kind is the `rule`."""

    def __init__(self, rule: LimitKind) -> None:
        self.rule, self.limited = rule, rule.limited

    @abstractmethod
    def asked(self, *, everywhere: bool) -> str:
        """Return how often the limit must be kept, in a few words."""

    @abstractmethod
    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:
        """Return what was counted in complete test runs: `count` of them, in words `runs`."""

    @abstractmethod
    def said_of_draws(self, runs: Runs, unit: str, confidence: float, *, passed: bool) -> str:
        """Return why the draws of a certificate show the limit, or do not."""

    @abstractmethod
    def said_of_contexts(
        self,
        worst: Sequence[InContext],
        refuting: Sequence[InContext],
        unit: str,
        *,
        passed: bool,
    ) -> str:
        """Return why the runs in the worst contexts show the limit, or do not.

        Parameters
        ----------
        worst
            The contexts that may be the worst, by their mean, the worst one first.
        refuting
            Those that refute the limit.
        unit
            Of the metric.
        passed
            Whether it is shown.
        """

    @abstractmethod
    def said_together(self, both: str, together: float) -> str:
        """Return that earlier and fresh runs, in words `both`, together break the limit."""

    @abstractmethod
    def predicted(self, metric: str, *, quantile: bool) -> str:
        """Name what models predict in a figure: a quantile of runs, or a mean, of a `metric`."""

    @property
    @abstractmethod
    def decisive(self) -> str:
        """What is compared with the limit in a figure of the worst contexts, in words."""


class OfRuns(Words):
    """Of a limit that a share of single runs must keep."""

    def asked(self, *, everywhere: bool) -> str:  # noqa: D102
        share = f"in {100.0 * self.rule.level:g} % of the runs"
        return f"{share} in every context" if everywhere else share

    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:  # noqa: D102
        permitted = self.rule.permitted(count)
        return f"{violations} of {runs} {self.limited.beyond} the limit, {permitted} permitted"

    def said_of_draws(  # noqa: D102
        self, runs: Runs, unit: str, confidence: float, *, passed: bool
    ) -> str:
        events = runs.events
        needed, draws = draws_needed(self.rule.allowed, confidence), len(events)
        rule = "" if draws >= needed else f" ({needed} draws without any are needed)"
        bound = float(probability_bounds(events, confidence)[-1]) if draws else 1.0
        return (
            f"{sum(events)} of {draws} draws violate the limit or fail{rule}: "
            f"{self._probability(bound, passed=passed)}"
        )

    def said_of_contexts(  # noqa: D102
        self,
        worst: Sequence[InContext],
        refuting: Sequence[InContext],
        unit: str,
        *,
        passed: bool,
    ) -> str:
        top = max(worst, key=lambda w: w.violation_bound)
        runs = text.counted(top.evaluations, "run")
        return (
            f"{place_of(top, worst)}{top.beyond} of {runs} violate the limit: "
            f"{self._probability(top.violation_bound, passed=passed)}"
        )

    def said_together(self, both: str, together: float) -> str:  # noqa: D102
        allowed = self.rule.allowed
        share = text.shown_beside(together, allowed)
        return f"{both} together violate the limit with a share of {share}, allowed {allowed:.4g}"

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        worst = self.rule.in_every_context
        if quantile:
            level = self.rule.level if self.limited.sign > 0.0 else self.rule.allowed
            return f"{'worst ' if worst else ''}{level:.4g} quantile of {metric}"
        return f"{'worst' if worst else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return (
            "What a run in the worst context that was found keeps with a probability of "
            f"{self.rule.level:g}"
        )

    def _probability(self, bound: float, *, passed: bool) -> str:
        """Return the bound of the probability of a violation beside what is allowed."""
        return (
            f"violation probability {'at most' if passed else 'may be'} "
            f"{text.shown_beside(bound, self.rule.allowed)}, allowed {self.rule.allowed:.4g}"
        )


class OfMean(Words):
    """Of a limit that the mean over noise keeps."""

    def __init__(self, rule: LimitKind) -> None:
        super().__init__(rule)
        self.proof = ProofByMean(rule)

    def asked(self, *, everywhere: bool) -> str:  # noqa: D102
        return f"by the mean over noise{' in every context' if everywhere else ''}"

    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:  # noqa: D102
        beyond = self.limited.beyond
        if not agrees:
            return f"the mean over {runs} is {beyond} the limit"
        text = f"{violations} of {runs} {beyond} the limit"
        return f"{text}, which is on the mean" if violations else text

    def said_of_draws(  # noqa: D102
        self, runs: Runs, unit: str, confidence: float, *, passed: bool
    ) -> str:
        if self.proof.needs_range(runs):
            return self._mixed("draws")
        bound = self.proof.bound(runs, confidence)
        if not np.isfinite(bound):
            return f"too few draws ({len(runs.values)}) to bound the mean over contexts and noise"
        return f"mean over contexts and noise {self._bounded(bound, unit, passed=passed)}"

    def said_of_contexts(  # noqa: D102
        self,
        worst: Sequence[InContext],
        refuting: Sequence[InContext],
        unit: str,
        *,
        passed: bool,
    ) -> str:
        limit = f"limit {self.limited.limit:g} {unit}".rstrip()
        sign, side = self.limited.sign, self.limited.side
        # The bound decides: the context with the largest mean need not have the largest bound.
        top = max(worst, key=lambda w: sign * w.mean.bound(side))
        bound = top.mean.bound(side)
        if refuting and not np.isfinite(bound):
            # A refutation ends the evaluations before there are enough runs for a bound.
            by = refuting[0]
            return (
                f"mean over noise {f'in a context ({by.place}) ' if by.place else ''}is "
                f"{text.shown_beside(by.mean.value, self.limited.limit)}, {limit}: "
                f"{by.evaluations} test runs show that it is not kept"
            )
        where = place_of(top, worst)
        if mixed := [w for w in worst if w.needs_range]:
            return self._mixed(f"test runs {place_of(mixed[0], worst)}".rstrip())
        if not np.isfinite(bound):
            return f"too few test runs ({top.evaluations}) {where}to bound the mean over noise"
        return f"mean over noise {where}{self._bounded(bound, unit, passed=passed)}"

    def said_together(self, both: str, together: float) -> str:  # noqa: D102
        mean = text.shown_beside(together, self.limited.limit)
        return f"{both} together have a mean of {mean}, limit {self.limited.limit:g}"

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        return f"{'worst' if self.rule.in_every_context else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return "The mean in the worst context that was found"

    def _mixed(self, runs: str) -> str:
        return (
            f"the {runs} are of two kinds, so that only a range bounds their mean: give "
            f"metrics.{self.limited.metric} a range, or limit single runs (probability)"
        )

    def _bounded(self, bound: float, unit: str, *, passed: bool) -> str:
        """Return the bound of a mean beside the limit."""
        says = "may be"
        if passed:
            says = "at most" if self.limited.sign > 0.0 else "at least"
        limit = f"limit {self.limited.limit:g} {unit}".rstrip()
        return f"{says} {text.shown_beside(bound, self.limited.limit)}, {limit}"


@singledispatch
def words_of_kind(rule: LimitKind) -> Words:
    """Return what is said of a limit, by the class of its kind."""
    raise TypeError(f"no words for a limit of the kind {type(rule).__name__}")


words_of_kind.register(OnRuns, OfRuns)
words_of_kind.register(OnMean, OfMean)


def words_of(constraint: Constraint) -> Words:
    """Return what is said of a limit."""
    return words_of_kind(constraint.rule)


def place_of(top: InContext, worst: Sequence[InContext]) -> str:
    """Name a context among the worst ones, with a space at its end; empty if there is but one."""
    which = "the worst context" if top is worst[0] else "the least certain of the worst contexts"
    return f"in {which} ({top.place}) " if top.place else ""
