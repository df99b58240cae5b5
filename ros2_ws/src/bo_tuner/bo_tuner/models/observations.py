"""What the models of both stages learn from: observations in contexts, worst cases of trials."""

from collections.abc import Sequence

import numpy as np

from bo_tuner.models.censoring import Censored
from bo_tuner.numerics.arrays import Array
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
        if metric in evaluation.outcome.notes.at_least
    ]
    return Censored(
        np.array([point for point, _ in cut]).reshape(-1, points.shape[1]),
        contexts.cube_of([evaluation.context for _, evaluation in cut]),
        np.array([evaluation.outcome.notes.at_least[metric] for _, evaluation in cut]),
    )


def searched_contexts(trials: Sequence[Trial]) -> list[Context]:
    """Return the contexts where searches for the worst one, and repetitions, have looked."""
    return [
        evaluation.context
        for trial in trials
        for evaluation in trial.evaluations
        if evaluation.stage in SEEKING_WORST
    ]
