"""Ramps: how the numbers of nodes that run go from one parameter set to the next.

Each double goes along a straight line on its own scale, in steps of `PERIOD`. Integers, truth
values and texts have nothing in between; they change at the end, with the last step.
"""

from collections.abc import Mapping
from math import ceil, isfinite

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.straight_lines import between, has_line, line_of
from bo_tuner.study.study import Study

PERIOD = 0.1
"""Time [s] of a step."""

NodeValues = Mapping[str, Mapping[str, object]]
"""Parameters by node key, then by name."""


class Ramp:
    """The steps of a study's nodes from what they have to what they are to have next.

    Parameters
    ----------
    study
        The study. One without ``run.ramp`` has no such steps.

    Attributes
    ----------
    period : float
        Time [s] from one step to the next.
    """

    def __init__(self, study: Study) -> None:
        seconds = 0.0 if study.run is None else study.run.ramp or 0.0
        # To the last bit of a time that is a multiple of the period.
        self._count = max(ceil(seconds / PERIOD - 1e-9), 1)
        self.period = seconds / self._count
        at_start = study.start_names
        self._parameters = [
            item
            for item in study.parameters.values()
            if item.type == "double"
            and has_line(study.parameters, item)
            and _in_node(item) not in at_start.get(item.node, ())
        ]
        self._lines = {item.name: line_of(study.parameters, item) for item in self._parameters}

    def steps(self, present: NodeValues, wanted: NodeValues) -> list[dict[str, dict[str, object]]]:
        """Return what to set, by node key and name, step by step; the last step is `wanted` itself.

        That one is not among them. There are none if no double changes. What a node does not have
        yet, and what it has that is no finite number, changes at the end.
        """
        shares = np.arange(1, self._count) / self._count
        steps: list[dict[str, dict[str, object]]] = [{} for _ in shares]
        for item in self._parameters:
            first, last = _value(item, present), _value(item, wanted)
            if first is None or last is None or checks.holds(first, last):
                continue
            values = between(*self._lines[item.name], first, last, shares)
            for step, value in zip(steps, values.tolist(), strict=True):
                _put(item, step, present, value)
        return steps if any(steps) else []

    def __bool__(self) -> bool:
        """Whether there is one at all."""
        return self._count > 1


def _in_node(item: Parameter) -> str:
    """Return the name of what is set on the node: for an item, that of its array."""
    return item.array or item.parameter


def _value(item: Parameter, values: NodeValues) -> float | None:
    """Return the value of a parameter among those of nodes; None if it has none."""
    value = values.get(item.node, {}).get(_in_node(item))
    if item.array and isinstance(value, (list, tuple)):
        value = value[item.item] if item.item < len(value) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
        return None
    return float(value)


def _put(
    item: Parameter, step: dict[str, dict[str, object]], present: NodeValues, value: float
) -> None:
    """Put the value of a parameter into a step; other items of an array stay as they are."""
    name, of_node = _in_node(item), step.setdefault(item.node, {})
    if not item.array:
        of_node[name] = value
        return
    items = of_node.get(name, present[item.node][name])
    if isinstance(items, (list, tuple)):
        of_node[name] = (*items[: item.item], value, *items[item.item + 1 :])
