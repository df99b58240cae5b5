"""The expected gain of one more trial."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

OWN_STREAM = 2**31 + 1
"""Part of the seed of the random draws, in place of the trial number of a proposal."""


@dataclass(frozen=True)
class Outlook:
    """Expected gain of one more trial, and the uncertainty of the incumbent.

    Attributes
    ----------
    incumbent
        Posterior mean of the cost of the best parameter set that is believed feasible.
    gain
        Largest value of the acquisition function, in the unit of the cost.
    noise
        Standard error of the incumbent's cost, in the same unit.
    """

    incumbent: float
    gain: float
    noise: float


def draws_of_outlook(study: Study, trials: Sequence[Trial]) -> np.random.Generator:
    """Return the random draws of an outlook after so many trials."""
    return generator(study.seed, Stream.ACQUISITION, OWN_STREAM, len(trials))
