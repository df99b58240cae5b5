"""What is common to limits on the mean over noise."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from bo_tuner import text
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.mean_tests import (
    Betting,
    MeanTest,
    NormalOrSkewed,
    is_mean_shown,
    mean_bound,
)
from bo_tuner.numerics.sequential import is_mean_refuted, is_shown
from bo_tuner.study.limit_kinds.base import InContext, LimitKind, Runs, place_of
from bo_tuner.study.limit_kinds.on_runs import COINCIDENCE

LEAST_RUNS = 30
"""Least number of runs behind a mean that counts as shown. The bound of a mean takes the noise for
normal: a few runs that agree do not exclude rare large values."""

TAIL = (
    "the noise is taken for normal or log-normal; of such laws with a mean just beyond the limit "
    "about 1 in 100 passes within five certificates, of rare large values that no run has shown "
    "far more: give the metric a range, or limit single runs (probability)"
)
"""Assumption of a certificate of a mean if its metric has no range; the level is measured by
benchmarks/repeated_certificates.py."""


class OnMean(LimitKind):
    """A limit that the mean over noise keeps; single runs may be beyond it."""

    on_runs = False

    @property
    def level(self) -> float:  # noqa: D102
        return 0.5

    @property
    def allowed(self) -> float:  # noqa: D102
        return 1.0

    def permitted(self, count: int) -> None:
        """Return None: any number of runs may be beyond the limit."""

    def agrees(self, values: Array, *, alone: bool) -> bool:
        """Return whether the mean of the values (n,), or its lower end, keeps the limit."""
        # Subtracted before the mean: the mean of equal values may differ from them by rounding.
        beyond = self.limited.sign * (values - self.limited.limit)
        estimated = self.is_estimated(alone=alone)
        return (float(beyond.mean()) if estimated else _lowest_mean(beyond)) <= 0.0

    def is_shown_by(self, violations: int, count: int, confidence: float) -> bool:
        """Return False: a number of violations does not bound the mean."""
        return False

    def runs_needed(self, confidence: float) -> int:  # noqa: D102
        return 1

    def fewest(  # noqa: D102
        self, declared: tuple[float, float] | None, confidence: float
    ) -> int:
        return self._test(declared).fewest(self.limited.sign * self.limited.limit, confidence)

    def assumption(self, declared: tuple[float, float] | None) -> str:  # noqa: D102
        return TAIL if declared is None else ""

    def is_shown(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        sign, test = self.limited.sign, self._test(runs.declared)
        limit, least = sign * self.limited.limit, self.runs_behind_bound(runs)
        shown = is_mean_shown(sign * runs.values, limit, confidence, test, least)
        # A declared range bounds rare values; without it the runs must exclude them.
        return shown and (runs.declared is not None or self._excludes_rare(runs, confidence))

    def bound(self, runs: Runs, confidence: float) -> float:
        """Return the confidence bound of the mean on the side of the limit."""
        sign, test = self.limited.sign, self._test(runs.declared)
        least = self.runs_behind_bound(runs)
        return sign * mean_bound(sign * runs.values, confidence, test, least)

    def _test(self, declared: tuple[float, float] | None) -> MeanTest:
        """Return the test that a mean is within an upper limit; a lower limit is mirrored."""
        if declared is None:
            return NormalOrSkewed()
        low, high = declared
        return Betting(low, high) if self.limited.sign > 0.0 else Betting(-high, -low)

    def is_refuted(self, runs: Runs, confidence: float) -> bool:  # noqa: D102
        sign = self.limited.sign
        return is_mean_refuted(sign * runs.values, sign * self.limited.limit, confidence)

    def is_hopeless(self, runs: Runs, most: int, confidence: float) -> bool:
        """Return whether the runs refute it: otherwise further runs can move the mean anywhere."""
        return self.is_refuted(runs, confidence)

    def runs_behind_bound(self, runs: Runs) -> int:
        """Return the number of runs from which on the mean has a bound.

        Once any run of the parameter set is beyond the limit, they are `LEAST_RUNS` in the context,
        or more, so that one of them differs from the first. Before that, runs elsewhere count as
        well: all of the parameter set or, if those in this context are equal, those in contexts in
        which they are equal, too.
        """
        values = runs.values
        if self.limited.violations(runs.farthest):
            return max(LEAST_RUNS, 1 + int(np.argmax(values != values[:1]))) if len(values) else 1
        if not _are_equal(values):
            return max(1, LEAST_RUNS + len(values) - max(runs.known, len(values)))
        alike = sum(len(v) for v in runs.elsewhere if _are_equal(v))
        return max(1, LEAST_RUNS + len(values) - alike)

    def together(self, runs: Runs) -> float:
        """Return the mean of the values; NaN of none."""
        return float(runs.values.mean()) if len(runs.values) else float("nan")

    def contradicts(self, together: float) -> bool:  # noqa: D102
        return bool(self.limited.violations(together))

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
        values, least = runs.values, self.runs_behind_bound(runs)
        if len(values) < max(least, 2):
            return f"too few draws ({len(values)}) to bound the mean over contexts and noise"
        bound = self.bound(runs, confidence)
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
        if not np.isfinite(bound):
            return f"too few test runs ({top.evaluations}) {where}to bound the mean over noise"
        if not passed and not self.limited.violations(bound):
            return (
                f"{sum(w.evaluations for w in worst)} test runs in the worst contexts say too "
                "little about the noise to show that the mean over it is within the limit"
            )
        return f"mean over noise {where}{self._bounded(bound, unit, passed=passed)}"

    def said_together(self, both: str, together: float) -> str:  # noqa: D102
        mean = text.shown_beside(together, self.limited.limit)
        return f"{both} together have a mean of {mean}, limit {self.limited.limit:g}"

    def predicted(self, metric: str, *, quantile: bool) -> str:  # noqa: D102
        return f"{'worst' if self.in_every_context else 'mean'} {metric}"

    @property
    def decisive(self) -> str:  # noqa: D102
        return "The mean in the worst context that was found"

    def _bounded(self, bound: float, unit: str, *, passed: bool) -> str:
        """Return the bound of a mean beside the limit."""
        says = "may be"
        if passed:
            says = "at most" if self.limited.sign > 0.0 else "at least"
        limit = f"limit {self.limited.limit:g} {unit}".rstrip()
        return f"{says} {text.shown_beside(bound, self.limited.limit)}, {limit}"

    def _excludes_rare(self, runs: Runs, confidence: float) -> bool:
        """Return whether runs in a context exclude that rare values take its mean beyond the limit.

        Equal runs say nothing of values that do not occur among them. If other runs have the worst
        known value, the mean is beyond the limit only if they have at least the probability
        that is tested here.
        """
        values, worst = runs.values, runs.farthest
        if not _are_equal(values) or not self.limited.violations(worst):
            return True
        rare = float((self.limited.limit - values[0]) / (worst - values[0]))
        return is_shown([False] * len(values), rare, confidence)


def _are_equal(values: Array) -> bool:
    return len(values) > 0 and float(np.ptp(values)) == 0.0


def _lowest_mean(values: Array) -> float:
    """Return the lower bound (Student's t) of the mean of values (n,), of level `COINCIDENCE`."""
    count = len(values)
    if count < 2:
        return -math.inf
    error = float(values.std(ddof=1)) / math.sqrt(count)
    return float(values.mean()) - float(stdtrit(count - 1, 1.0 - COINCIDENCE)) * error
