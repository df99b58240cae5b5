"""Fantasies: the results that models expect of pending trials.

A proposal that did not know of the trials that are pending would ask for the same as they do. So
the posterior mean at a pending trial is taken for its result, as if it had been observed: the
kriging believer of Ginsbourger, Le Riche and Carraro (2010, Sec. 4.1). The models of a method then
have little uncertainty left there, and its acquisition function looks elsewhere. Hyperparameters
are those of the results alone, as there: fitted to means as well, length scales would grow, and
noise would vanish.

References
----------
Ginsbourger, Le Riche and Carraro (2010). Kriging is well-suited to parallelize optimization. In
Computational Intelligence in Expensive Optimization Problems, Springer.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.models.compression import Compression
from bo_tuner.models.fitting import Fitting
from bo_tuner.models.pooled_process import PooledProcesses
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    Context,
    Evaluation,
    EvaluationState,
    Outcome,
    Trial,
    TrialState,
    WorstCase,
)

Scale = tuple[Callable[[Array], Array], Callable[[Array], Array]]
"""Takes values (N,) of a metric to the scale on which it is modelled, and back."""

Mean = Callable[[Array, Array], Array]
"""Returns the mean (k,) of a metric, in its unit, at a point (d,) in contexts (k, e)."""


def fantasies(
    study: Study, trials: Sequence[Trial], pending: Sequence[Trial], rng: np.random.Generator
) -> list[Trial]:
    """Return pending trials as complete, with posterior means as their results.

    Parameters
    ----------
    study
        The study.
    trials
        Those that have ended. Without a complete one nothing is expected.
    pending
        Those that are not finished, with planned evaluations in the contexts that they begin in.
    rng
        Draws starting points of the fits.
    """
    complete = [t for t in trials if t.state is TrialState.COMPLETE]
    if not complete or not pending:
        return []
    fitting = Fitting(study, complete, rng, None)
    means = {
        name: _mean(fitting, complete, name, scale) for name, scale in _scales(study, complete)
    }
    return [_believed(study, trials, trial, means) for trial in pending]


def _scales(study: Study, trials: Sequence[Trial]) -> Iterator[tuple[str, Scale]]:
    """Yield the metrics that methods learn from, each with its scale: of costs or beyond limits."""
    seen: set[str] = set()
    for item in study.objectives:
        seen.add(item.metric)
        yield item.metric, (item.to_cost, item.from_cost)
    for limit in study.constraints.values():
        if limit.metric not in seen:
            seen.add(limit.metric)
            values = [e.outcome.metrics[limit.metric] for e in _complete(trials)]
            scale = Compression.of(np.array(values), limit.limit, limit.sign)
            yield limit.metric, (scale.apply, scale.restore)
    for name in study.measured:
        if name not in seen:
            yield name, (np.asarray, np.asarray)


def _complete(trials: Sequence[Trial]) -> Iterator[Evaluation]:
    return (e for trial in trials for e in trial.evaluations if e.outcome.complete)


def _mean(fitting: Fitting, trials: Sequence[Trial], metric: str, scale: Scale) -> Mean:
    """Fit a process of all evaluations of a metric."""
    apply, restore = scale
    x, c, y = fitting.joint_observations(trials, metric)
    process = fitting.process(PooledProcesses(), metric, x, c, apply(y))

    def mean(point: Array, contexts: Array) -> Array:
        return restore(process.means(point[None], contexts)[0])

    return mean


def _believed(
    study: Study, trials: Sequence[Trial], pending: Trial, means: dict[str, Mean]
) -> Trial:
    space, contexts = study.search_space(), study.context_space()
    point = space.to_cube(pending.parameters)
    points = contexts.cube_of([e.context for e in pending.evaluations])
    values = {name: mean(point, points) for name, mean in means.items()}
    evaluations = tuple(
        replace(
            evaluation,
            outcome=Outcome(
                EvaluationState.COMPLETE,
                {name: float(predicted[k]) for name, predicted in values.items()},
            ),
        )
        for k, evaluation in enumerate(pending.evaluations)
    )
    worst_cases: dict[str, WorstCase] = {}
    places = contexts.candidates()
    for limit in study.worst_case_constraints:
        everywhere = means[limit.metric](point, places)
        worst = int(np.argmax(limit.sign * everywhere))
        context: Context = contexts.to_dict(contexts.to_contexts(places[worst : worst + 1])[0])
        value = float(everywhere[worst])
        noise = [t.worst_cases[limit.name].noise for t in trials if limit.name in t.worst_cases]
        usual = float(np.median(noise)) if noise else 0.0
        worst_cases[limit.name] = WorstCase(value, context, value, usual)
    return replace(
        pending,
        state=TrialState.COMPLETE,
        reason="",
        evaluations=evaluations,
        worst_cases=worst_cases,
    )
