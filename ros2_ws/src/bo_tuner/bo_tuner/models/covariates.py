"""Measured contexts as further columns of the data, and what predictions know of them.

What is measured is not known ahead. A prediction is one over the values that were seen so far, each
run's as probable as any other's, and so never beyond their range.

Notation: n complete evaluations, w measured contexts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.measured import values_in
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

ROWS = 16
"""Values that stand for all that were seen where a response is averaged over them."""


@dataclass(frozen=True, eq=False)
class Covariates:
    """The measured contexts of evaluations.

    Attributes
    ----------
    seen : ndarray, shape (n, w)
        Their values, in own units.
    """

    seen: Array

    @classmethod
    def of(cls, study: Study, trials: Sequence[Trial]) -> "Covariates":
        """Return those of all complete evaluations."""
        return cls(measured_in(study, trials))

    def unit(self, values: Array) -> Array:
        """Map values (m, w) to the unit cube that the seen ones span."""
        low, high = self.seen.min(axis=0), self.seen.max(axis=0)
        scaled: Array = (values - low) / np.where(high > low, high - low, 1.0)
        return scaled

    def rows(self, count: int) -> Array:
        """Return seen values (count, w) in the unit cube: a quantile each of the first context.

        Those of the others come from the same runs, so that what belongs together stays together.
        """
        order = np.lexsort(self.seen.T[::-1])
        places = (np.arange(count) + 0.5) * len(order) / count
        return self.unit(self.seen[order[places.astype(np.intp)]])

    def beside(self, contexts: Array) -> Array:
        """Add seen values to contexts (k, e) that were drawn, in no relation to these."""
        if not self.seen.shape[1]:
            return contexts
        # The same in every fit, as the contexts are, which have the seed 0.
        order = np.random.default_rng(1).permutation(len(contexts))
        return np.hstack([contexts, self.rows(len(contexts))[order]])


def measured_in(study: Study, trials: Sequence[Trial]) -> Array:
    """Return the values (n, w), in own units, in the order of `joint_observations`."""
    return values_in(study.measured, (e for trial in trials for e in trial.evaluations))
