"""Runs of a simulation as prior knowledge of the machine, with a bias that is modelled.

A run of the simulation is data of the same process as one of the machine, at another place along
one further column. Between the two the kernel is ρ times that of parameter set and context,

    ρ = exp(-½ (APART / ℓ)²),

the intrinsic coregionalization of two tasks (Bonilla, Chai and Williams 2007), which Swersky, Snoek
and Adams (2013) have used for Bayesian optimization. Their difference, the *bias*, is so a process
over parameter set and context, too, with the prior variance 2 s² (1 - ρ); how alike they are, ℓ, is
fitted with the other hyperparameters. Its constant part, which may be larger than all effects, is
taken first, from the parameter sets that both have run (`moved`). All predictions are those of the
machine. The noise is estimated around a place, so that of a simulation is hardly taken for that of
the machine.

References
----------
Bonilla, Chai and Williams (2007). Multi-task Gaussian process prediction. NeurIPS 20.
Swersky, Snoek and Adams (2013). Multi-task Bayesian optimization. NeurIPS 26.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.fitting import Fitting
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState, pooled

SIMULATED, APART = 0.0, 0.5
"""Places of simulation and machine along their column, in edges of the unit cube.

With the prior median of the length scales, √d / 2 in d columns, ρ is 0.78 in two, 0.88 in four.
"""


def is_simulated(trial: Trial) -> bool:
    """Return whether a trial is one of a `Simulation`: these are numbered from -1 downwards."""
    return trial.number < 0


def column_of(simulated: NDArray[np.bool_]) -> Array:
    """Return the column (n, 1) of runs (n,) of the simulation or of the machine."""
    column: Array = np.where(simulated, SIMULATED, APART)[:, None]
    return column


def moved(x: Array, y: Array, simulated: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return responses (n,), those of the simulation moved to the machine's, and by how much.

    It is the mean difference at the parameter sets that both have run; 0 without any.

    Parameters
    ----------
    x : ndarray, shape (n, d)
        Parameter sets of runs.
    y : ndarray, shape (n,)
        Their responses, on the scale of the model.
    simulated : ndarray of bool, shape (n,)
        Which runs are of the simulation.
    """
    _, index = np.unique(x, axis=0, return_inverse=True)
    index = index.reshape(-1)
    sides = []
    for side in (~simulated, simulated):
        counts = np.bincount(index, side, minlength=index.max() + 1)
        sums = np.bincount(index, np.where(side, y, 0.0), minlength=len(counts))
        sides.append((counts, sums))
    (own, own_sums), (other, other_sums) = sides
    shared = (own > 0) & (other > 0)
    if not shared.any():
        return y, 0.0
    differences = own_sums[shared] / own[shared] - other_sums[shared] / other[shared]
    offset = float(differences.mean())
    return y + np.where(simulated, offset, 0.0), offset


@dataclass(frozen=True)
class Simulation:
    """Trials of a simulation of the machine.

    Attributes
    ----------
    trials
        Each parameter set as one trial.
    outliers
        Numbers of those that are outliers of the objective, which say nothing of the others.
    """

    trials: tuple[Trial, ...] = ()
    outliers: frozenset[int] = frozenset()

    @classmethod
    def of(cls, study: Study, trials: Sequence[Trial]) -> Self:
        """Return that of trials, whatever their numbers."""
        own = [
            replace(
                trial,
                number=-1 - number,
                evaluations=tuple(replace(e, trial=-1 - number) for e in trial.evaluations),
                hyperparameters={},
            )
            for number, trial in enumerate(pooled(trials))
        ]
        complete = [trial for trial in own if trial.state is TrialState.COMPLETE]
        outliers: frozenset[int] = frozenset()
        if complete:
            fitting = Fitting(study, complete, np.random.default_rng(0), None)
            outliers = fitting.outliers(complete)
        return cls(tuple(own), outliers)

    @property
    def usual(self) -> list[Trial]:
        """The trials without outliers."""
        return [trial for trial in self.trials if trial.number not in self.outliers]
