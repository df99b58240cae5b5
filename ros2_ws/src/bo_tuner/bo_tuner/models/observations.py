"""What the models of both stages learn from: observations in contexts, worst cases of trials."""

from collections.abc import Sequence

import numpy as np

from bo_tuner.models.censoring import Censored
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import SEEKING_WORST, Context, Evaluation, Trial


def joint_observations(
    points: Array, contexts: ContextSpace, trials: Sequence[Trial], metric: str
) -> tuple[Array, Array, Array]:
    """Return parameter sets (N, d), contexts (N, e) and values (N,) of all complete evaluations.

    The first two are in the unit cube, as are the `points` (n, d), the parameter sets of the n
    trials; the values are in the metric's unit.
    """
    runs = [sum(e.outcome.complete for e in trial.evaluations) for trial in trials]
    complete = complete_evaluations(trials)
    return (
        np.repeat(points, runs, axis=0),
        contexts.cube_of([evaluation.context for evaluation in complete]),
        np.array([evaluation.outcome.metrics[metric] for evaluation in complete]),
    )


def complete_evaluations(trials: Sequence[Trial]) -> list[Evaluation]:
    """Return the complete evaluations of trials, in the order of `joint_observations`."""
    return [e for trial in trials for e in trial.evaluations if e.outcome.complete]


def known_errors(trials: Sequence[Trial], metric: str) -> Array | None:
    """Return the known standard errors (N,) of `joint_observations`, in the metric's unit.

    NaN stands for one that is not known; None if none is.
    """
    errors = [e.outcome.notes.errors.get(metric, np.nan) for e in complete_evaluations(trials)]
    return None if np.isnan(errors).all() else np.array(errors)


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
