"""What every peer needs: scaled constraints and permitted values."""

from collections.abc import Mapping

from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.optimizer import Observation


def excesses(study: Study, observation: Observation) -> dict[str, float]:
    """Excess over each limit relative to the limit's size, so that constraints are comparable."""
    return {
        name: value / (abs(study.constraints[name].upper) or 1.0)
        for name, value in observation.constraints.items()
    }


def permitted(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Tuned parameters as they are if the order permits them, moved to the nearest that it does.

    A round trip through the unit cube changes the last digit of a double; values that are permitted
    keep theirs, so that a peer recognises what it asked for.
    """
    repaired = tuned(space, space.to_parameters(space.to_cube(parameters)))
    same = space.key(repaired) == space.key(parameters)
    return dict(parameters) if same else repaired


def tuned(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Tuned ones of a whole parametrization."""
    return {name: parameters[name] for name in space.names}
