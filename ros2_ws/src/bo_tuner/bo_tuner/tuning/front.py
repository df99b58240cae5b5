"""The Pareto front of a run with several objectives.

A parameter set is on it if no other one that is believed feasible, and kept all limits in its own
evaluations, has better means of all objectives. The means are over all evaluations of a trial in
drawn contexts, those of its check included, and each has the interval of Student's t.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from bo_tuner.numerics.pareto import nondominated
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import WITHIN, outcome_in_words
from bo_tuner.study.study import Study
from bo_tuner.trials import pooled

CONFIDENCE = 0.95
"""Of the interval of a mean."""

RULE = (
    "the compromise, the point of the Pareto front nearest to the ideal point (augmented Chebyshev "
    "distance with equal weights)"
)
"""How the result is chosen among the points of the front."""


@dataclass(frozen=True)
class Mean:
    """Mean of an objective's metric over evaluations, in its unit.

    Attributes
    ----------
    value
        The mean.
    error
        Half the width of its interval; NaN from a single evaluation.
    count
        Number of evaluations.
    """

    value: float
    error: float
    count: int


@dataclass(frozen=True)
class Point:
    """A parameter set of the front.

    Attributes
    ----------
    trial
        Number of its trial.
    means
        By the metric of each objective.
    feasibility
        Probability that all constraints hold, by the surrogates.
    """

    trial: int
    means: dict[str, Mean]
    feasibility: float


def pareto_front(study: Study, ranked: Sequence[Candidate]) -> list[Point]:
    """Return the points of the front in the order of the first objective, the best first.

    Parameters
    ----------
    study
        The study.
    ranked
        As from `Ranking.rank`, with the evaluations of checks.
    """
    # In a space smaller than the budget several trials are of one set.
    firsts: dict[object, Candidate] = {}
    for candidate in ranked:
        firsts.setdefault(candidate.trial.parameter_set, candidate)
    joint = zip(firsts.values(), pooled(c.trial for c in ranked), strict=True)
    points = [
        Point(
            first.trial.number,
            {item.metric: _mean(trial.observations(item.metric)) for item in study.objectives},
            first.feasibility,
        )
        for first, trial in joint
        if first.believed_feasible and outcome_in_words(study, trial) == WITHIN
    ]
    if not points:
        return []
    costs = np.array(
        [[item.sign * p.means[item.metric].value for item in study.objectives] for p in points]
    )
    on_front = np.flatnonzero(nondominated(costs))
    return [points[k] for k in sorted(on_front, key=lambda k: costs[k].tolist())]


def _mean(values: Sequence[float]) -> Mean:
    count = len(values)
    error = math.nan
    if count > 1:
        quantile = float(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE))
        error = quantile * float(np.std(values, ddof=1)) / math.sqrt(count)
    return Mean(float(np.mean(values)), error, count)
