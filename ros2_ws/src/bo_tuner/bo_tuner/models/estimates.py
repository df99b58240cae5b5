"""Worst cases of trials by models that know the contexts."""

from dataclasses import replace

from bo_tuner.models.surrogates import Surrogates
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, WorstCase


def estimated(study: Study, models: Surrogates, trial: Trial) -> Trial:
    """Return a trial with its worst cases as the models of all evaluations estimate them.

    Those estimated when it was run know nothing of evaluations that came later. Where a model knows
    no contexts, the worst case stays as it is.
    """
    contexts = study.context_space()
    x = study.search_space().to_cube(trial.parameters)[None]
    worst_cases = dict(trial.worst_cases)
    for name in trial.worst_cases:
        # Of trials that have all failed when they were run again there is no model.
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
