"""What an optimizer offers that chooses the contexts itself, one evaluation at a time.

The published robust optimizers are of this kind: each evaluation is a parameter set and a context.
An experiment file names one as `module:Class` with the protocol ``own``. It takes the single
evaluations of its run's initial trials first, the same ones that the tuner's algorithms start from;
what it then asks for is counted evaluation by evaluation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Value


@dataclass(frozen=True)
class Result:
    """Result of one evaluation.

    Attributes
    ----------
    parameters
        The tuned parameters only, in their own units.
    context
        Value of each context variable.
    cost
        On the study's scale for surrogates, the smaller the better; None if it failed.
    excess
        Metric of the worst-case constraint less its limit, relative to the limit's size; None if
        the evaluation failed.
    """

    parameters: Mapping[str, Value]
    context: Context
    cost: float | None
    excess: float | None


class RobustOptimizer(Protocol):
    """An optimizer of the tuned parameters of a study with a worst-case constraint.

    Parameters
    ----------
    study : Study
        The study.
    seed : int
        Source of everything random.
    """

    def __init__(self, study: Study, seed: int) -> None: ...

    def ask(self) -> tuple[Mapping[str, Value], Context]:
        """Return every tuned parameter and the context of the next evaluation."""
        ...

    def tell(self, result: Result) -> None:
        """Take the result of an evaluation; also of those that it did not ask for."""
        ...

    def recommend(self) -> Mapping[str, Value] | None:
        """Return evaluated parameters, the tuned ones, that it would use; None without any."""
        ...


def worst_case_constraint(study: Study) -> Constraint:
    """Return the limit that these optimizers know.

    Raises
    ------
    ValueError
        If the study has none, or more than one.
    """
    constraints = study.worst_case_constraints
    if len(constraints) != 1:
        raise ValueError(f"expected one worst_case constraint, found {len(constraints)}")
    return constraints[0]


def result_of(study: Study, evaluation: Evaluation) -> Result:
    """Sum up an evaluation for an optimizer.

    Raises
    ------
    ValueError
        If the study has no worst-case constraint, or more than one.
    """
    constraint = worst_case_constraint(study)
    tuned = {name: evaluation.parameters[name] for name in study.search_space().names}
    if not evaluation.outcome.complete:
        return Result(tuned, evaluation.context, None, None)
    metrics = evaluation.outcome.metrics
    cost = float(study.objective.to_cost(metrics[study.objective.metric]))
    excess = constraint.excess(metrics[constraint.metric])
    return Result(tuned, evaluation.context, cost, excess)
