"""How a parametrization fares against its neighbours: a narrow optimum is not a robust one."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bo_tuner.benchmark.truth import FEW_REAL_CUTS, Truth, Verdict, verdict_record
from bo_tuner.recommendation import TOLERABLE
from bo_tuner.trials import Value

STEP = 0.05
"""A neighbour in a continuous direction is this part of the range away."""


def judge_neighbours(
    truth: Truth, parameters: Mapping[str, Value], verdict: Verdict
) -> list[dict[str, Any]]:
    """Judge the parametrizations one step away, in each tuned parameter and both directions.

    An integer's step is 1. A neighbour is ``tolerable`` if it exceeds neither the limit of the
    worst case, nor the objective of `verdict`, by more than `TOLERABLE`.

    Returns
    -------
    list of dict
        ``changed`` (parameter and value), ``truth`` and ``tolerable`` of each.
    """
    judged = []
    for changed, neighbour in _neighbours(truth, parameters):
        found = truth.verdict(neighbour, FEW_REAL_CUTS)
        worse = abs(verdict.objective) * TOLERABLE
        sign = 1.0 if truth.study.objective.direction == "minimize" else -1.0
        tolerable = (
            found.worst <= truth.limit + TOLERABLE * abs(truth.limit)
            and sign * (found.objective - verdict.objective) <= worse
        )
        judged.append(
            {
                "parameters": neighbour,
                "changed": changed,
                "truth": verdict_record(found),
                "tolerable": bool(tolerable),
            }
        )
    return judged


def _neighbours(
    truth: Truth, parameters: Mapping[str, Value]
) -> list[tuple[str, dict[str, Value]]]:
    space = truth.study.search_space()
    tuned = {name: parameters[name] for name in space.names}
    found = []
    for neighbour in space.integer_neighbours(tuned):
        (changed,) = (name for name in space.names if neighbour[name] != tuned[name])
        found.append((changed, neighbour))
    for column in np.flatnonzero(~space.integer):
        name = space.names[column]
        width = float(space.upper[column] - space.lower[column])
        for sign in (-1.0, 1.0):
            value = float(tuned[name]) + sign * STEP * width
            moved = float(np.clip(value, space.lower[column], space.upper[column]))
            if moved != tuned[name]:
                cube = space.to_cube(tuned | {name: moved})
                found.append((name, space.to_parameters(cube) | {name: moved}))
    return found
