"""A parameter set compared with its neighbours: a narrow optimum is not a robust one."""

from collections.abc import Iterable, Mapping
from typing import Any

from bo_tuner.models.narrowness import TOLERABLE
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, Truth, Verdict, verdict_record


def judge_neighbours(
    truth: Truth, parameters: Mapping[str, Value], verdict: Verdict
) -> list[dict[str, Any]]:
    """Judge the parameter sets one step away, see `SearchSpace.neighbours`.

    Returns
    -------
    list of dict
        ``parameters``, the names of the ``changed`` ones, ``truth`` and ``tolerable`` of each.
    """
    judged = []
    space = truth.study.search_space()
    for neighbour in space.neighbours(parameters):
        truth_there = truth.verdict(neighbour, FEW_REAL_EVALUATIONS)
        tolerable = is_tolerable(
            truth.study, verdict.objective, truth_there.objective, truth_there.worst
        )
        judged.append(
            {
                "parameters": neighbour,
                "changed": [name for name in space.names if neighbour[name] != parameters[name]],
                "truth": verdict_record(truth_there),
                "tolerable": tolerable,
            }
        )
    return judged


def is_tolerable(study: Study, objective: float, there: float, worst: float) -> bool:
    """Whether a neighbour is no reason to call a parameter set narrow.

    Its objective `there` is worse than `objective`, and its `worst` case above the limit, by no
    more than the part `TOLERABLE`.
    """
    within = all(item.excess(worst) <= TOLERABLE for item in study.worst_case_constraints)
    of = study.objective
    loss = of.relative_loss(of.to_cost(there), of.to_cost(objective))
    return bool(within and loss <= TOLERABLE)


def deciding(study: Study, changed: Iterable[str]) -> bool:
    """Whether a step of the `changed` parameters counts: one of an integer, if there are integers.

    Where a limit is active, a step of a real parameter exceeds it by an amount that depends on the
    arbitrary length of the step; an integer's step has no such choice.
    """
    space = study.search_space()
    integers = {name for name, integer in zip(space.names, space.integer, strict=True) if integer}
    return not integers or bool(integers.intersection(changed))
