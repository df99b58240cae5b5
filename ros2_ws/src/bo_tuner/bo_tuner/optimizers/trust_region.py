"""A trust region: where a search of many parameters proposes.

In tens of dimensions a global model knows nothing of almost all of the cube, and an expected
improvement is largest at its faces. So points are proposed in a box around the best parameter set
so far, whose edge grows after successes and shrinks after failures (Algorithm 1 of TuRBO with one
region and one trial at a time). The best is the one with the lowest cost among those that keep all
limits by their own runs, or the least violating one, as in SCBO. When the box has become too small,
it begins anew around the best: unlike theirs, all data stay, since a run of a machine is dear.

References
----------
Eriksson, Pearce, Gardner, Turner and Poloczek (2019). Scalable global optimization via local
Bayesian optimization. NeurIPS 32, Sec. 3 and supplement A.
Eriksson and Poloczek (2021). Scalable constrained Bayesian optimization. AISTATS.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.box import Box
from bo_tuner.study.limits import held_against
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState

MANY = 50
"""Tuned parameters, of which more are searched in a trust region."""
FIRST, SHORTEST, LONGEST = 0.8, 2.0**-7, 1.6
"""Edge of the box at first, below which it begins anew, and at most, in edges of the cube."""
SUCCESSES, FAILURES = 3, 4
"""In a row, that double the edge, and that halve it at least; of many parameters d failures."""
BETTER = 1e-3
"""Of the best cost, by which a lower one is a success."""
PERTURBED = 20
"""Coordinates, on average, in which a starting point of the search differs from the best."""

Merit = tuple[float, float]
"""By how much limits are violated, relative to them, and the cost: less is better."""
FAILED: Merit = (math.inf, math.inf)


def edge(merits: Iterable[Merit], best: Merit, dimension: int) -> float:
    """Return the edge of the box after trials with these merits.

    Parameters
    ----------
    merits
        Of the trials after the initial design, in their order.
    best
        The best merit of the initial design.
    dimension
        Number of tuned parameters.
    """
    length, successes, failures = FIRST, 0, 0
    for merit in merits:
        is_better = _is_better(merit, best)
        best = min(best, merit)
        successes, failures = (successes + 1, 0) if is_better else (0, failures + 1)
        if successes == SUCCESSES:
            length, successes = min(2.0 * length, LONGEST), 0
        elif failures == max(FAILURES, dimension):
            length, failures = length / 2.0, 0
        if length < SHORTEST:
            length = FIRST
    return length


def _is_better(merit: Merit, best: Merit) -> bool:
    violation, cost = merit
    if violation != best[0]:
        return violation < best[0]
    return cost < best[1] - BETTER * abs(best[1])


@dataclass(frozen=True, eq=False)
class TrustRegion(Box):
    """The box around the best parameter set.

    Attributes
    ----------
    centre : ndarray, shape (d,)
        That set, in the unit cube.
    """

    centre: Array

    def latin_hypercube(self, count: int, rng: np.random.Generator) -> Array:
        """Draw points (count, d), which differ from the centre in some coordinates only."""
        points = super().latin_hypercube(count, rng)
        dimension = len(self.centre)
        moved = rng.random(points.shape) < min(1.0, PERTURBED / dimension)
        # One at least.
        moved[np.arange(count), rng.integers(dimension, size=count)] = True
        return np.where(moved, points, self.centre)


def trust_region(study: Study, trials: Sequence[Trial], scales: Array | None) -> TrustRegion | None:
    """Return the trust region after trials; None before one of them is complete.

    Parameters
    ----------
    study
        The study.
    trials
        All so far, in their order.
    scales : ndarray, shape (d,), or None
        Length scales of the model of the cost: along a long one the box is longer, too.
    """
    space, merits = study.search_space(), [_merit(study, trial) for trial in trials]
    if not merits or min(merits) == FAILED:
        return None
    initial = study.budget.initial_trials
    length = edge(merits[initial:], min(merits[:initial], default=FAILED), space.dimension)
    centre = space.to_cube(trials[merits.index(min(merits))].parameters)
    weights = np.ones(space.dimension)
    if scales is not None:
        weights = scales / np.exp(np.log(scales).mean())
    # A choice has no neighbours.
    half = np.where(np.array(space.levels) > 0, 1.0, 0.5 * length * weights)
    return TrustRegion(np.maximum(centre - half, 0.0), np.minimum(centre + half, 1.0), centre)


def _merit(study: Study, trial: Trial) -> Merit:
    """Return the merit of a trial by its own runs."""
    objective = study.objective
    mean = trial.mean(objective.metric)
    if trial.state is not TrialState.COMPLETE or mean is None:
        return FAILED
    limits = study.constraints.values()
    violation = sum(max(limit.excess(held_against(limit, trial)), 0.0) for limit in limits)
    return violation, float(objective.to_cost(mean))
