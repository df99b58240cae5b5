"""What is common to limits on the mean over noise."""

import math

from scipy.special import stdtrit

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.limit_kinds.base import LimitKind
from bo_tuner.study.limit_kinds.on_runs import COINCIDENCE


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


def _lowest_mean(values: Array) -> float:
    """Return the lower bound (Student's t) of the mean of values (n,), of level `COINCIDENCE`."""
    count = len(values)
    if count < 2:
        return -math.inf
    error = float(values.std(ddof=1)) / math.sqrt(count)
    return float(values.mean()) - float(stdtrit(count - 1, 1.0 - COINCIDENCE)) * error
