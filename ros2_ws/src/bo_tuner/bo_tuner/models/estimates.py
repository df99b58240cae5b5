"""Worst cases of trials by models that know the contexts."""

from dataclasses import replace

from bo_tuner.models.surrogates import Surrogates
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, WorstCase


def estimated(study: Study, models: Surrogates, trial: Trial) -> Trial:
    """Return a trial with the worst cases that models of all evaluations estimate.

    The estimates of its own time know nothing of later evaluations. Where a model knows no
    contexts, the worst case stays as it is.
    """
    contexts = study.context_space()
    x = study.search_space().to_cube(trial.parameters)[None]
    worst_cases = dict(trial.worst_cases)
    for name in trial.worst_cases:
        # There is no model if all trials failed when they were run again.
        constraint, response = study.constraints[name], models.constraints.get(name)
        estimate = None if response is None else response.estimate(x)
        if estimate is not None:
            point, value, noise = estimate
            context = contexts.to_dict(contexts.to_contexts(point[None])[0])
            values = [
                evaluation.outcome.metrics[constraint.metric]
                for evaluation in trial.evaluations
                if evaluation.outcome.complete
            ]
            worst_cases[name] = WorstCase(value, context, constraint.farthest(values), noise)
    return replace(trial, worst_cases=worst_cases)
