"""Which parameter set to use: one function decides for the command line, files and reports.

Among the parameter sets that were tried, those believed feasible are ranked by the posterior
mean of the cost plus a penalty for a narrow optimum: what a step to a neighbour costs on average.
The luckiest noisy sample does not win, and a point whose neighbours are bad loses to a calmer one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.surrogates import DEFAULT_MODELS, ModelOptions, Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState

BELIEVED_FEASIBLE = 0.5
"""Probability of feasibility from which a parameter set is a candidate."""

TOLERABLE = 0.2
"""A relative loss at a neighbour up to this is no sign of a narrow optimum.

Where a limit is active some neighbours always exceed it a little.
"""

LARGEST_STEP = 0.1
"""A neighbour in a continuous direction is at most this part of the range away."""


@dataclass(frozen=True)
class Candidate:
    """A tried parameter set and what the surrogates believe of it.

    Attributes
    ----------
    trial
        The trial.
    objective
        Posterior mean of the objective, in the metric's unit.
    feasibility
        Probability that all constraints hold.
    violation
        Largest predicted excess over a limit, relative to the limit; negative if within all.
    penalty
        Mean relative loss at the neighbours beyond `TOLERABLE`, in cost and over limits.
    score
        Cost plus penalty, by which feasible candidates are ranked.
    """

    trial: Trial
    objective: float
    feasibility: float
    violation: float
    penalty: float
    score: float

    @property
    def believed_feasible(self) -> bool:
        """Whether this is a candidate for use."""
        return self.feasibility >= BELIEVED_FEASIBLE


def rank(
    study: Study,
    trials: Sequence[Trial],
    options: ModelOptions = DEFAULT_MODELS,
) -> list[Candidate]:
    """Rank the complete trials, outliers of the objective excepted, the recommended one first.

    Those believed feasible come first, by score; the others follow, the least violating first.

    Parameters
    ----------
    study
        The study.
    trials
        All trials so far.
    options
        As in `Surrogates.fit`.

    Returns
    -------
    list of Candidate
        Empty if no trial is complete.
    """
    space = study.search_space()
    rng = generator(study.seed, Stream.ACQUISITION, 2**31, len(trials))
    models = Surrogates.fit(study, trials, rng=rng, options=options)
    # The model of the objective was not told the outliers, so it cannot judge them.
    complete = [
        t for t in trials if t.state is TrialState.COMPLETE and t.number not in models.outliers
    ]
    if models.objective is None:
        return []
    scale = 1.0 if study.objective.scale == "log" else models.objective.scale
    candidates = []
    for trial in complete:
        x = space.to_cube(trial.parameters)[None]
        (cost,) = models.objective.predict(x)[0]
        (excess,) = relative_excess(models, x)
        around = neighbourhood(space, trial, models)
        loss = (models.objective.predict(around)[0] - cost) / scale
        penalty = float(np.mean(intolerable(loss) + intolerable(relative_excess(models, around))))
        candidates.append(
            Candidate(
                trial=trial,
                objective=float(study.objective.from_cost(cost)),
                feasibility=float(np.exp(models.log_feasibility(x)[0])),
                violation=float(excess),
                penalty=penalty,
                score=float(cost + scale * penalty),
            )
        )
    return sorted(
        candidates,
        key=lambda c: (0, c.score) if c.believed_feasible else (1, c.violation),
    )


def neighbourhood(space: SearchSpace, trial: Trial, models: Surrogates) -> Array:
    """Points (m, d) one integer step, or half a length scale, away from a trial.

    The length scale is the shortest of all models; the half of it is at most `LARGEST_STEP`.
    """
    x = space.to_cube(trial.parameters)
    # A joint model has the contexts behind the parameters.
    d = space.dimension
    scales = np.min([m.length_scales[:d] for m in models.models.values()], axis=0)
    points = [space.to_cube(neighbour) for neighbour in space.integer_neighbours(trial.parameters)]
    for column in np.flatnonzero(~space.integer):
        for sign in (-1.0, 1.0):
            moved = x.copy()
            moved[column] += sign * min(0.5 * scales[column], LARGEST_STEP)
            points.append(space.repair(moved[None])[0])
    return np.array(points)


def intolerable(loss: Array) -> Array:
    """Part of a relative loss (m,) that is beyond `TOLERABLE`."""
    return np.maximum(loss - TOLERABLE, 0.0)


def relative_excess(models: Surrogates, x: Array) -> Array:
    """Largest predicted excess (m,) over a limit, relative to the limit's size."""
    if not models.constraints:
        return np.full(len(x), -np.inf)
    excess = [
        (c.predict(x)[0] - c.limit) / max(abs(c.limit), np.finfo(float).tiny)
        for c in models.constraints.values()
    ]
    largest: Array = np.max(excess, axis=0)
    return largest
