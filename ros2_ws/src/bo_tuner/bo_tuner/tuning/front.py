"""The Pareto front of a run with several objectives.

A parameter set is on it if no other one that is believed feasible, and kept all limits in its own
evaluations, has better means of all objectives. Where each objective has a model of all evaluations
(`boundary`), the means and their intervals are those of its posterior. Elsewhere they are over all
evaluations of a trial in drawn contexts, those of its check included, with the interval of
Student's t.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from bo_tuner.numerics.pareto import nondominated
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import keeps_limits
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, pooled

CONFIDENCE = 0.95
"""Of the interval of a mean."""

RULE = (
    "the compromise, the point of the Pareto front nearest to the ideal point (augmented Chebyshev "
    "distance with equal weights)"
)
"""How the result is chosen among the points of the front."""


@dataclass(frozen=True)
class Mean:
    """Mean of an objective's metric, in its unit.

    Attributes
    ----------
    value
        The mean.
    error
        Half the width of its interval; NaN from a single evaluation.
    count
        Number of evaluations that it is over; of an estimate, all of the parameter set.
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
    modelled
        Whether the means are those of models of all evaluations, not of its own evaluations.
    """

    trial: int
    means: dict[str, Mean]
    feasibility: float
    modelled: bool


def pareto_front(study: Study, ranked: Sequence[Candidate]) -> list[Point]:
    """Return the points of the front in the order of the first objective, the best first."""
    # In a space smaller than the budget several trials have the same parameter set.
    firsts: dict[object, Candidate] = {}
    for candidate in ranked:
        firsts.setdefault(candidate.trial.parameter_set, candidate)
    joint = zip(firsts.values(), pooled(c.trial for c in ranked), strict=True)
    points = [
        Point(
            first.trial.number,
            {item.metric: _mean(first, trial, item.metric) for item in study.objectives},
            first.feasibility,
            bool(first.estimates),
        )
        for first, trial in joint
        if first.believed_feasible and keeps_limits(study, trial)
    ]
    if not points:
        return []
    costs = np.array(
        [[item.sign * p.means[item.metric].value for item in study.objectives] for p in points]
    )
    on_front = np.flatnonzero(nondominated(costs))
    return [points[k] for k in sorted(on_front, key=lambda k: costs[k].tolist())]


def _mean(candidate: Candidate, trial: Trial, metric: str) -> Mean:
    """Return the mean of a metric: its estimate, or else that over the evaluations of a trial."""
    estimate = candidate.estimates.get(metric)
    if estimate is not None:
        evaluations = sum(evaluation.outcome.complete for evaluation in trial.evaluations)
        half = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * estimate.error
        return Mean(estimate.mean, half, evaluations)
    values = trial.observations(metric)
    count = len(values)
    error = math.nan
    if count > 1:
        quantile = float(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE))
        error = quantile * float(np.std(values, ddof=1)) / math.sqrt(count)
    return Mean(float(np.mean(values)), error, count)
