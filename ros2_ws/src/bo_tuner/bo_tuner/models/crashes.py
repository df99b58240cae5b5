"""Probability that no run of a parameter set fails, as a constraint that is learnt.

A run that fails is an observed violation: a Gaussian process of an indicator, 1 for a failed run
and -1 for a complete one, must stay below 0. It is one over parameter set and context, so a context
in which runs fail counts before a parameter set has been tried there. A process smooths the edge of
a region; close to a parameter set that failed, its nearest neighbours decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.categories import Coding
from bo_tuner.models.context_process import ContextProcesses
from bo_tuner.models.hyperpriors import Hyperpriors, LogNormal
from bo_tuner.models.nearest_neighbours import NeighbourClassifier
from bo_tuner.models.pooled_responses import EveryContext
from bo_tuner.numerics.arrays import Array

# An indicator that steps from -1 to 1 looks like noise, or like structure of no extent, to a
# process that is free to see it so. It is to see regions.
PRIORS = Hyperpriors(
    length_scale=LogNormal(0.5, 0.5, 0.2, 20.0),
    signal=LogNormal(1.0, 0.5, 0.2, 5.0),
    noise=LogNormal(0.3, 0.5, 0.05, 1.0),
)


@dataclass(frozen=True, eq=False)
class CrashModel:
    """Model of failed runs; build it by `fit`.

    Attributes
    ----------
    labels : ndarray of bool, shape (N,)
        Which runs failed.
    constraint : EveryContext or None
        On the indicator, in every context; None while no run has failed.
    neighbours : NeighbourClassifier
        Of the parameter sets with a failed run.
    """

    labels: NDArray[np.bool_]
    constraint: EveryContext | None
    neighbours: NeighbourClassifier

    @classmethod
    def fit(
        cls,
        x: Array,
        c: Array,
        labels: NDArray[np.bool_],
        *,
        processes: ContextProcesses,
        coding: Coding,
        contexts: Array,
        neighbours: NeighbourClassifier,
        rng: np.random.Generator,
        start: Sequence[float] | None = None,
    ) -> Self:
        """Fit to runs of the parameter sets x (N, d) in the contexts c (N, e).

        Parameters
        ----------
        x, c
            In their unit cubes.
        labels
            Which runs failed, (N,).
        processes
            Makes the process.
        coding
            Of the parameters' columns.
        contexts : ndarray, shape (k, e)
            Candidates for the worst one.
        neighbours
            Of the parameter sets with a failed run.
        rng
            Draws starting points of the fit.
        start
            `warm_start` of an earlier fit, to be kept. A new fit starts anew: a few more failures
            can change all that an indicator says.
        """
        if not labels.any():
            return cls(labels, None, neighbours)
        indicator = np.where(labels, 1.0, -1.0)
        process = processes.fit(
            x, c, indicator, coding=coding, rng=rng, priors=PRIORS, start=start, keep=True
        )
        return cls(labels, EveryContext(process, 0.0, contexts), neighbours)

    @property
    def warm_start(self) -> tuple[float, ...] | None:
        """Hyperparameters for a later fit; None while no run has failed."""
        return None if self.constraint is None else self.constraint.process.warm_start

    def probability(self, x: Array) -> Array:
        """Return the probability (m,) of a failed run at x (m, d)."""
        return -np.expm1(self.log_complement(x))

    def log_complement(self, x: Array) -> Array:
        """Return the log probability (m,) that no run fails at x (m, d)."""
        if self.constraint is None:
            return np.zeros(len(x))
        return np.minimum(self.constraint.log_probability(x), self.neighbours.log_complement(x))
