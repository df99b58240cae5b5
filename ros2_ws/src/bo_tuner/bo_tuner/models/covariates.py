"""Columns of the data beside the contexts: what was measured, and whether it was simulated.

What is measured is not known ahead. A prediction is one over the values that were seen so far, each
run's as probable as any other's, and so never beyond their range. It is always one of the machine,
whether or not runs of its simulation are data, too.

Notation: n complete evaluations, w measured contexts; w' is w, or w + 1 with a simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.simulation import column_of, is_simulated
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.measured import values_in
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

ROWS = 16
"""Values that stand for all that were seen where a response is averaged over them."""


@dataclass(frozen=True, eq=False)
class Covariates:
    """The further columns of evaluations.

    Attributes
    ----------
    seen : ndarray, shape (n, w)
        The values of the measured contexts, in own units.
    simulated : ndarray of bool, shape (n,), or None
        Which evaluations are of a simulation; None without one, and then there is no column of it.
    """

    seen: Array
    simulated: NDArray[np.bool_] | None = None

    @classmethod
    def of(cls, study: Study, trials: Sequence[Trial]) -> "Covariates":
        """Return those of all complete evaluations."""
        simulated = simulated_in(trials)
        return cls(measured_in(study, trials), simulated if simulated.any() else None)

    @property
    def width(self) -> int:
        """Number of columns, w'."""
        return int(self.seen.shape[1]) + (self.simulated is not None)

    @property
    def own(self) -> Array:
        """Columns (n, w') of the evaluations themselves."""
        return self._with_column(self.unit(self.seen), self.simulated)

    @property
    def to_average(self) -> Array:
        """Values (r, w') that a response of the machine is averaged over."""
        return self.rows(ROWS if self.seen.shape[1] else 1)

    def columns(self, study: Study, trials: Sequence[Trial]) -> Array:
        """Return the columns (N, w') of the complete evaluations of some of the trials."""
        measured = self.unit(measured_in(study, trials))
        return self._with_column(measured, simulated_in(trials))

    def unit(self, values: Array) -> Array:
        """Map measured values (m, w) to the unit cube that the seen ones span."""
        if not len(self.seen):
            return values
        low, high = self.seen.min(axis=0), self.seen.max(axis=0)
        scaled: Array = (values - low) / np.where(high > low, high - low, 1.0)
        return scaled

    def rows(self, count: int) -> Array:
        """Return columns (count, w') of the machine: a quantile each of the first measured context.

        Those of the others come from the same runs, so that what belongs together stays together.
        What a simulation has measured counts only as long as the machine has measured nothing.
        """
        seen = self.seen
        if self.simulated is not None and not self.simulated.all():
            seen = seen[~self.simulated]
        if seen.shape[1]:
            order = np.lexsort(seen.T[::-1])
            places = (np.arange(count) + 0.5) * len(order) / count
            measured = self.unit(seen[order[places.astype(np.intp)]])
        else:
            measured = np.empty((count, 0))
        return self._with_column(measured, np.zeros(count, dtype=bool))

    def beside(self, contexts: Array) -> Array:
        """Add columns of the machine to drawn contexts (k, e), in no relation to these."""
        if not self.width:
            return contexts
        # The same in every fit, as the contexts are, which have the seed 0.
        order = np.random.default_rng(1).permutation(len(contexts))
        return np.hstack([contexts, self.rows(len(contexts))[order]])

    def _with_column(self, measured: Array, simulated: NDArray[np.bool_] | None) -> Array:
        if self.simulated is None or simulated is None:
            return measured
        return np.hstack([measured, column_of(simulated)])


def measured_in(study: Study, trials: Sequence[Trial]) -> Array:
    """Return the values (n, w), in own units, in the order of `joint_observations`."""
    return values_in(study.measured, (e for trial in trials for e in trial.evaluations))


def simulated_in(trials: Sequence[Trial]) -> NDArray[np.bool_]:
    """Return which complete evaluations (n,) are simulated, ordered as `joint_observations`."""
    return np.array(
        [is_simulated(t) for t in trials for e in t.evaluations if e.outcome.complete], dtype=bool
    )
