"""What is common to limits that a share of single runs must keep.

References
----------
Clopper and Pearson (1934). The use of confidence or fiducial limits illustrated in the case of the
binomial. Biometrika 26(4).
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import bdtr, bdtrc

from bo_tuner import text
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.sequential import (
    draws_needed,
    is_hopeless,
    is_refuted,
    is_shown,
    probability_bounds,
)
from bo_tuner.study.limit_kinds.base import InContext, LimitKind, Runs, place_of

COINCIDENCE = 0.05
"""Probability below which draws refute a limit in every context."""


class OnRuns(LimitKind):
    """A limit that runs keep with the `level`."""

    on_runs = True

    @property
    def level(self) -> float:  # noqa: D102
        return 1.0 if self.limited.probability is None else self.limited.probability

    @property
    def allowed(self) -> float:  # noqa: D102
        return 1.0 - self.level

    def permitted(self, count: int) -> int:
        """Return floor(allowed count); 1e-9 compensates for the rounding of 1 - probability."""
        return math.floor(self.allowed * count + 1e-9)

    def most_violations(self, count: int, *, alone: bool) -> int:
        """Return how many of `count` draws may violate the limit before they refute it.

        It is the `permitted` number if draws estimate the share of violations, and otherwise the
        largest k with P(X >= k) >= `COINCIDENCE` for X ~ Binomial(count, allowed).
        """
        if self.is_estimated(alone=alone):
            return self.permitted(count)
        above = np.arange(1, count + 1)
        return int(np.sum(bdtrc(above - 1, count, self.allowed) >= COINCIDENCE))

    def agrees(self, values: Array, *, alone: bool) -> bool:
        """Return whether no more of the values (n,) are beyond the limit than `most_violations`."""
        most = self.most_violations(len(values), alone=alone)
        return int(np.sum(self.limited.violations(values))) <= most

    def is_shown_by(self, violations: int, count: int, confidence: float) -> bool:
        """Return whether the bound of Clopper and Pearson (1934) is at most what is allowed.

        P(X <= violations) <= 1 - confidence for X ~ Binomial(count, allowed).
        """
        return float(bdtr(violations, count, self.allowed)) <= 1.0 - confidence

    def fewest(  # noqa: D102
        self, declared: tuple[float, float] | None, confidence: float
    ) -> int:
        return draws_needed(self.allowed, confidence)

    def is_shown(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        return is_shown(runs.events, self.allowed, confidence)

    def is_refuted(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        return is_refuted(runs.events, self.allowed, confidence)

    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:  # noqa: D102
        return is_hopeless(runs.events, most, self.allowed, confidence)

    def together(self, runs: Runs) -> float:
        """Return the share of runs beyond the limit or failed."""
        return float(np.mean(runs.events))

    def contradicts(self, together: float) -> bool:  # noqa: D102
        return together > self.allowed

    def asked(self, *, everywhere: bool) -> str:  # noqa: D102
        share = f"in {100.0 * self.level:g} % of the runs"
        return f"{share} in every context" if everywhere else share

    def counted(self, violations: int, runs: str, count: int, *, agrees: bool) -> str:  # noqa: D102
        permitted = self.permitted(count)
        return f"{violations} of {runs} {self.limited.beyond} the limit, {permitted} permitted"

    def said_of_draws(  # noqa: D102
        self, runs: Runs, unit: str, confidence: float, *, passed: bool
    ) -> str:
        events = runs.events
        needed, draws = draws_needed(self.allowed, confidence), len(events)
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
        share = text.shown_beside(together, self.allowed)
        return (
            f"{both} together violate the limit with a share of {share}, allowed {self.allowed:.4g}"
        )

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        worst = self.in_every_context
        if quantile:
            level = self.level if self.limited.sign > 0.0 else self.allowed
            return f"{'worst ' if worst else ''}{level:.4g} quantile of {metric}"
        return f"{'worst' if worst else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return (
            "What a run in the worst context that was found keeps with a probability of "
            f"{self.level:g}"
        )

    def _probability(self, bound: float, *, passed: bool) -> str:
        """Return the bound of the probability of a violation beside what is allowed."""
        return (
            f"violation probability {'at most' if passed else 'may be'} "
            f"{text.shown_beside(bound, self.allowed)}, allowed {self.allowed:.4g}"
        )
