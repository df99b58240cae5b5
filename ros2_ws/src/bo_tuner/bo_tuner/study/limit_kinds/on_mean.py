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
from bo_tuner.numerics.sequential import is_mean_refuted
from bo_tuner.numerics.two_kinds import RARE, gap
from bo_tuner.study.limit_kinds.base import InContext, LimitKind, Runs, place_of
from bo_tuner.study.limit_kinds.on_runs import COINCIDENCE

TAIL = (
    f"the noise is normal or log-normal, without a second kind of runs in less than "
    f"{100.0 * RARE:g} % of them; to be sure give the metric a range, or limit single runs "
    "(probability)"
)
"""Assumption of a certificate of a mean if its metric has no range; the level is measured by
benchmarks/repeated_certificates.py and benchmarks/false_passes.py."""


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

    def fewest(  # noqa: D102
        self, declared: tuple[float, float] | None, confidence: float
    ) -> int:
        return self._test(declared).fewest(self.limited.sign * self.limited.limit, confidence)

    def assumption(  # noqa: D102
        self, declared: tuple[float, float] | None
    ) -> tuple[str, str]:
        kinds = f"no rare runs are far beyond the {self.limited.metric} of the others"
        return (TAIL, kinds) if declared is None else ("", "")

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
        if self.needs_range(runs):
            return self._mixed("draws")
        bound = self.bound(runs, confidence)
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
        return f"{'worst' if self.in_every_context else 'mean'} {metric}"

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


def _lowest_mean(values: Array) -> float:
    """Return the lower bound (Student's t) of the mean of values (n,), of level `COINCIDENCE`."""
    count = len(values)
    if count < 2:
        return -math.inf
    error = float(values.std(ddof=1)) / math.sqrt(count)
    return float(values.mean()) - float(stdtrit(count - 1, 1.0 - COINCIDENCE)) * error
