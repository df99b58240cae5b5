"""What an optimizer that is no part of the tuner offers to take part in a campaign.

The campaign drives it by ask and tell. It is told the initial samples of its run first, all of
them, the same ones that the tuner's algorithms start from, and then the observation of each
parameter set that it asked for. The experiment file names it as `module:Class`. The functions below
help to write one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Value


@dataclass(frozen=True)
class Observation:
    """Result of one trial.

    Attributes
    ----------
    parameters : mapping from str to int or float
        The tuned parameters only, in their own units.
    failed : bool
        Whether an evaluation failed. The values below are then None or empty.
    objective : float or None
        Mean over the drawn contexts, in the study's scale for surrogates (see
        `Objective.to_cost`); smaller is better.
    constraints : mapping from str to float
        For each constraint the observed value minus the limit, in the metric's unit; the
        constraint holds if it is at most 0.
    """

    parameters: Mapping[str, Value]
    failed: bool
    objective: float | None
    constraints: Mapping[str, float]


class Optimizer(Protocol):
    """An optimizer of a study's tuned parameters, driven by ask and tell.

    Parameters
    ----------
    study : Study
        `study.search_space()` has the bounds, the integers and the repair of a point that breaks
        the order of two parameters.
    seed : int
        Source of everything random.
    """

    def __init__(self, study: Study, seed: int) -> None: ...

    def ask(self) -> dict[str, Value]:
        """Return every tuned parameter for the next trial: in bounds, in order, of its type."""
        ...

    def tell(self, observation: Observation) -> None:
        """Take the result of a trial; also of the initial samples, which it did not ask for."""
        ...

    def recommend(self) -> int | None:
        """Return the index of the told observation that it would use, by its own recommended way.

        Counts from 0 in the order of `tell`; None if no observation is feasible.
        """
        ...


def is_feasible(observation: Observation) -> bool:
    """Whether a trial was completed and kept all limits as observed."""
    return not observation.failed and all(v <= 0.0 for v in observation.constraints.values())


def best_observed(observations: Sequence[Observation]) -> int | None:
    """Index of the lowest observed objective of all that are feasible as observed, if any is."""
    objectives = {
        index: observation.objective
        for index, observation in enumerate(observations)
        if is_feasible(observation) and observation.objective is not None
    }
    return min(objectives, key=objectives.__getitem__, default=None)


def excesses(study: Study, observation: Observation) -> dict[str, float]:
    """Excess over each limit relative to the limit's size, so that constraints are comparable."""
    return {
        name: value / (abs(study.constraints[name].limit) or 1.0)
        for name, value in observation.constraints.items()
    }


def permitted(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Tuned parameters as they are if their order is permitted, else moved to the nearest that is.

    A round trip through the unit cube changes the last digit of a double; values that are permitted
    keep theirs, so that a peer recognizes what it asked for.
    """
    repaired = tuned(space, space.to_parameters(space.to_cube(parameters)))
    same = space.key(repaired) == space.key(parameters)
    return dict(parameters) if same else repaired


def tuned(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Tuned ones of all parameters."""
    return {name: parameters[name] for name in space.names}
