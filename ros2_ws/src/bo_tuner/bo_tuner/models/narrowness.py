"""How much is lost by a step away from an optimum, as models predict it."""

import numpy as np

from bo_tuner.models.protocol import Model
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study

TOLERABLE = 0.2
"""Largest relative loss at a neighbour that is not penalized.

Where a limit is active, some neighbours always exceed it slightly.
"""


def intolerable(loss: Array) -> Array:
    """Return the part (m,) of relative losses (m,) that exceeds `TOLERABLE`."""
    return np.maximum(loss - TOLERABLE, 0.0)


def relative_loss(study: Study, objective: Model, cost: Array, reference: Array) -> Array:
    """Return the `Objective.relative_loss` (m,) that a model of the cost predicts.

    Of several objectives, that of the cost of the compromise, relative to its spread.

    Parameters
    ----------
    study
        The study.
    objective
        The model.
    cost, reference : ndarray, shape (m,)
        Means that it predicts, and those that they are compared with.
    """
    if len(study.objectives) > 1:
        return (cost - reference) / objective.scale
    return study.objective.relative_loss(cost, reference, objective.scale)


def relative_excess(models: Surrogates, x: Array) -> Array:
    """Return the largest predicted excess (m,) over a limit at x (m, d).

    Relative to the limit's size, as `Constraint.excess`; not relative to a limit of 0.
    """
    if not models.constraints:
        return np.full(len(x), -np.inf)
    excess = [c.excess(x) / (abs(c.limit) or 1.0) for c in models.constraints.values()]
    largest: Array = np.max(excess, axis=0)
    return largest
