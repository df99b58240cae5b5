"""What the models of both stages learn from: observations in contexts, worst cases of trials."""

from collections.abc import Sequence

import numpy as np

from bo_tuner.models.censoring import Censored
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import SEEKING_WORST, Context, Trial


def joint_observations(
    points: Array, contexts: ContextSpace, trials: Sequence[Trial], metric: str
) -> tuple[Array, Array, Array]:
    """Return parameter sets (N, d), contexts (N, e) and values (N,) of all complete evaluations.

    The first two are in the unit cube, as are the `points` (n, d), the parameter sets of the n
    trials; the values are in the metric's unit.
    """
    complete = [
        (point, evaluation)
        for trial, point in zip(trials, points, strict=True)
        for evaluation in trial.evaluations
        if evaluation.outcome.complete
    ]
    return (
        np.array([point for point, _ in complete]).reshape(-1, points.shape[1]),
        contexts.cube_of([evaluation.context for _, evaluation in complete]),
        np.array([evaluation.outcome.metrics[metric] for _, evaluation in complete]),
    )


def censored_observations(
    points: Array, contexts: ContextSpace, trials: Sequence[Trial], metric: str
) -> Censored:
    """Return the lower bounds of a metric, in its unit, of all evaluations that were cut short.

    The `points` (n, d) are the parameter sets of the n trials, in the unit cube.
    """
    cut = [
        (point, evaluation)
        for trial, point in zip(trials, points, strict=True)
        for evaluation in trial.evaluations
        if metric in evaluation.outcome.at_least
    ]
    return Censored(
        np.array([point for point, _ in cut]).reshape(-1, points.shape[1]),
        contexts.cube_of([evaluation.context for _, evaluation in cut]),
        np.array([evaluation.outcome.at_least[metric] for _, evaluation in cut]),
    )


def searched_contexts(trials: Sequence[Trial]) -> list[Context]:
    """Return the contexts where searches for the worst one, and repetitions, have looked."""
    return [
        evaluation.context
        for trial in trials
        for evaluation in trial.evaluations
        if evaluation.stage in SEEKING_WORST
    ]


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
