"""What a single evaluation in the estimated worst context of a trial shows."""

from collections.abc import Sequence

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import Constraint
from bo_tuner.trials import Trial


def single_evaluation_worst_cases(trials: Sequence[Trial], constraint: Constraint) -> Array:
    """Return a quantile (n,) of single evaluations in the worst context of each trial.

    A single evaluation stays below it, or above for a lower limit, with the constraint's
    probability. Trials without a worst case are left out.
    """
    name = constraint.name
    worst = [t.worst_cases[name].value for t in trials if name in t.worst_cases]
    return np.array(worst) + constraint.sign * single_evaluation_margin(trials, constraint)


def single_evaluation_margin(trials: Sequence[Trial], constraint: Constraint) -> float:
    """Return the margin z σ of a mean to the limit, in the metric's unit.

    With it, a single evaluation keeps the limit with the constraint's probability; z is the normal
    quantile of that. σ is the median noise of all trials, as the few evaluations of one trial do
    not estimate it well.
    """
    name = constraint.name
    noise = [t.worst_cases[name].noise for t in trials if name in t.worst_cases]
    return constraint.deviations * float(np.median(noise)) if noise else 0.0
