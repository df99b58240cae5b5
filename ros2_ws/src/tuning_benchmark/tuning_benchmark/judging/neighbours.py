"""A parameter set compared with its neighbours: a narrow optimum is not a robust one."""

from collections.abc import Mapping
from typing import Any

from bo_tuner.optimizers.ranking import TOLERABLE
from bo_tuner.trials import Value
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, Truth, Verdict, verdict_record


def judge_neighbours(
    truth: Truth, parameters: Mapping[str, Value], verdict: Verdict
) -> list[dict[str, Any]]:
    """Judge the parameter sets one step away, see `SearchSpace.neighbours`.

    A neighbour is ``tolerable`` if it exceeds neither the limit of the worst case, nor the
    objective of `verdict`, by more than `TOLERABLE`.

    Returns
    -------
    list of dict
        ``parameters``, the names of the ``changed`` ones, ``truth`` and ``tolerable`` of each.
    """
    judged = []
    space = truth.study.search_space()
    for neighbour in space.neighbours(parameters):
        found = truth.verdict(neighbour, FEW_REAL_EVALUATIONS)
        worse = abs(verdict.objective) * TOLERABLE
        sign = truth.study.objective.sign
        tolerable = (
            found.worst <= truth.limit + TOLERABLE * abs(truth.limit)
            and sign * (found.objective - verdict.objective) <= worse
        )
        judged.append(
            {
                "parameters": neighbour,
                "changed": [name for name in space.names if neighbour[name] != parameters[name]],
                "truth": verdict_record(found),
                "tolerable": bool(tolerable),
            }
        )
    return judged
