"""Straight lines between two parameter sets: that of each double is straight on its scale.

What is no double has nothing in between; it changes at the end of the line.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from bo_tuner.errors import ParameterError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parameter_scale import LINEAR, scaled, unscaled
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.trials import Value

PAIRS = 128
"""Random lines by which conditions are judged."""
SHARES = np.array([0.25, 0.5, 0.75, 1.0])
"""Places on these. At the last one what is no double has still the value of the beginning."""


def between(scale: str, upper: float, first: float, last: float, shares: Array) -> Array:
    """Return the values (k,) at shares (k,) of the straight line from one value to another.

    The line is one on the scale, of a parameter with the upper bound `upper`; in the values
    themselves if one of them does not lie on it, such as 0 on a logarithmic one.
    """
    ends, bound = np.array([[first], [last]]), np.array([upper])
    with np.errstate(invalid="ignore", divide="ignore"):
        on_scale = scaled(scale, ends, bound)
    if not np.isfinite(on_scale).all():
        scale, on_scale = LINEAR, ends
    # In this form it does not overflow, however far apart the two are.
    positions = np.outer(1.0 - shares, on_scale[0]) + np.outer(shares, on_scale[1])
    values: Array = unscaled(scale, positions, bound)[:, 0]
    return np.clip(values, min(first, last), max(first, last))


@lru_cache(maxsize=16)
def broken_on_lines(space: SearchSpace) -> str:
    """Return what order or condition a straight line between two sets may break; empty if none.

    An order of two parameters on the same scale, and a linear condition on linear ones, hold on
    the way whatever its ends are. All are judged by random lines.
    """
    points = space.latin_hypercube(2 * PAIRS, np.random.default_rng(0))
    sets = [space.to_parameters(point) for point in points]
    parameters = {item.name: item for item in space.parameters}
    for first, last in zip(sets[:PAIRS], sets[PAIRS:], strict=True):
        ends = {
            item.name: (float(first[item.name]), float(last[item.name]))
            for item in space.parameters
            if item.type == "double" and item.is_tuned and item.is_number
        }
        lines = {
            name: between(*line_of(parameters, parameters[name]), *pair, SHARES).tolist()
            for name, pair in ends.items()
        }
        for place in range(len(SHARES)):
            on_the_way: dict[str, Value] = {name: line[place] for name, line in lines.items()}
            try:
                space.permitted({name: first[name] for name in space.names} | on_the_way)
            except ParameterError as error:
                return str(error)
    return ""


def has_line(parameters: Mapping[str, Parameter], item: Parameter) -> bool:
    """Return whether there are values between those of a double, itself or by a tie."""
    return item.leader(parameters).is_number


def line_of(parameters: Mapping[str, Parameter], item: Parameter) -> tuple[str, float]:
    """Return the scale and the upper bound that a parameter has, itself or by a tie."""
    leader = item.leader(parameters)
    return leader.scale, 0.0 if leader.bounds is None else float(leader.bounds[1])
