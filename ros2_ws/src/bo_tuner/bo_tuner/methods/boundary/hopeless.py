"""Beyond what a run shows that its parameter set cannot be the answer, so that it may end there.

A parameter set that keeps a limit is expected to have a run beyond it now and then: by noise, and
where the limit is one over contexts, by the context that was drawn. What is farther beyond it than
`DEVIATIONS` of these is not explained by them. The objective is taken in the same way: its limit is
the cost of the best parameter set so far. Values closer to a limit are seen whole, as they tell the
models where the boundary is.

Limits in every context are held against a run in any; what is over the distribution of the contexts
only against one in a context that was drawn from it.
"""

import numpy as np

from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.base import Hopeless
from bo_tuner.study.study import Study

DEVIATIONS = 3.0
"""Standard deviations of a run beyond which nothing is explained by noise or context."""

FAR = 1e6
"""How far a bound may be beyond its limit, relative to that."""


def hopeless_beyond(
    study: Study,
    surrogates: PooledSurrogates,
    point: Array,
    lowest: float,
) -> Hopeless:
    """Return beyond what a run of a parameter set is hopeless.

    Parameters
    ----------
    study
        The study.
    surrogates
        Models of all runs.
    point : ndarray, shape (d,)
        The parameter set in the unit cube.
    lowest
        Cost of the best parameter set that is believed to keep all limits.
    """
    x = point[None]
    anywhere: dict[str, float] = {}
    drawn: dict[str, float] = {}
    for name, response in surrogates.constraints.items():
        constraint = study.constraints[name]
        if response.sign < 0.0:
            continue
        explained = DEVIATIONS * float(response.deviation_of_run(x)[0])
        # A scale restores nothing beyond what is known, which may be within the limit.
        scale = response.scale.including(response.limit + FAR * (abs(response.limit) or 1.0))
        most = float(scale.restore(scale.apply(response.limit) + explained))
        bounds = anywhere if constraint.rule.in_every_context else drawn
        bounds[constraint.metric] = min(most, bounds.get(constraint.metric, most))
    objective, model = study.objective, surrogates.objective
    if model is None or study.further_objectives or objective.sign < 0.0:
        return Hopeless(anywhere, drawn)
    cost = lowest + DEVIATIONS * float(np.sqrt(model.variance_of_run(x)[0]))
    most = float(objective.from_cost(cost))
    drawn[objective.metric] = min(most, drawn.get(objective.metric, most))
    return Hopeless(anywhere, drawn)
