"""Tuned parameters of a result that are at a bound of the search, and wider bounds."""

import math
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bo_tuner.study.limit_kinds.limited import UPPER
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parameter_scale import LOG, SYMLOG
from bo_tuner.study.study import Study
from bo_tuner.trials import Value

LARGEST_FACTOR = 10.0
"""Factor by which a bound on a log scale moves at most."""


@dataclass(frozen=True)
class AtBound:
    """A tuned parameter at a bound: the optimum may lie beyond.

    Attributes
    ----------
    parameter, title, unit
        Its name, what screens call it, with the name, and its unit.
    side
        ``lower`` or ``upper``.
    bound
        The bound, in the parameter's unit.
    bounds
        Both bounds of the study.
    wider
        Bounds to go on with: on this side twice as wide, or on a log scale by `LARGEST_FACTOR` at
        most. A bound keeps its sign; None if no value beyond it has the same sign.
    """

    parameter: str
    title: str
    unit: str
    side: str
    bound: int | float
    bounds: tuple[int | float, int | float]
    wider: tuple[int | float, int | float] | None


def at_bounds(study: Study, parameters: Mapping[str, Value]) -> tuple[AtBound, ...]:
    """Return the tuned parameters of a set that are at a bound, to the resolution of the search."""
    sides = study.search_space().at_bounds(parameters)
    return tuple(at_bound(study.parameters[name], side) for name, side in sides.items())


def wider_options(bounds: Iterable[AtBound]) -> str:
    """Return the options of `tune` for wider bounds; empty without any."""
    return " ".join(
        f"--bounds {shlex.quote(f'{each.parameter}={_exact(lower)}:{_exact(upper)}')}"
        for each in bounds
        if each.wider is not None
        for lower, upper in (each.wider,)
    )


def _exact(value: int | float) -> str:
    """Return a number in full."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def at_bound(item: Parameter, side: str) -> AtBound:
    """Return a parameter at its bound on a side."""
    lower, upper = item.bounds or (math.nan, math.nan)
    bound, other = (upper, lower) if side == UPPER else (lower, upper)
    moved = _moved(item, bound, other)
    wider = None
    if moved != bound:
        wider = (lower, moved) if side == UPPER else (moved, upper)
    return AtBound(item.name, item.title_and_name, item.unit, side, bound, (lower, upper), wider)


def _moved(item: Parameter, bound: int | float, other: int | float) -> int | float:
    """Return a bound that is farther from the `other` one; the same if that changes its sign."""
    if item.scale == SYMLOG and bound > other:
        new = bound * LARGEST_FACTOR
    elif item.scale == LOG:
        ratio = bound / other
        new = bound * min(max(ratio, 1.0 / LARGEST_FACTOR), LARGEST_FACTOR)
    else:
        new = 2.0 * bound - other
        if bound == 0.0 or new * bound < 0.0:
            # A gain is hardly meant to change its sign.
            new = 0.0
    if item.is_integer:
        return _on_steps(item, bound, round(new))
    rounded = float(f"{new:.2g}")
    # Rounding must not take it back.
    new = rounded if abs(rounded - other) > abs(bound - other) else new
    return new if item.step is None else _on_steps(item, bound, new)


def _on_steps(item: Parameter, bound: int | float, new: int | float) -> int | float:
    """Return a bound in whole steps from the present one."""
    step = item.step or 1
    moved = bound + round((new - bound) / step) * step
    if item.scale == LOG and moved <= 0.0:
        # Rounding must not leave the scale.
        moved += step
    return int(moved) if item.is_integer else float(f"{moved:.12g}")
