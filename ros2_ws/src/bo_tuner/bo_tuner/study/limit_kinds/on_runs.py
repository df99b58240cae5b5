"""What is common to limits that a share of single runs must keep.

References
----------
Clopper and Pearson (1934). The use of confidence or fiducial limits illustrated in the case of the
binomial. Biometrika 26(4).
"""

import math

import numpy as np
from scipy.special import bdtr, bdtrc

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.limit_kinds.base import LimitKind

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
