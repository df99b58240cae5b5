"""Parameters that are computed from others, such as ``0.1 * kp``."""

from collections.abc import Mapping

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.conditions import Condition
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.signals import named_expression

TIED_TO = "tied_to"


class Derived:
    """A parameter whose value is an expression of others.

    Parameters
    ----------
    item : Parameter
        The parameter.
    parameters : mapping from str to Parameter
        The study's, by name.

    Attributes
    ----------
    condition : Condition
        What every parameter set keeps: its bounds, or without these that it is defined.

    Raises
    ------
    StudyError
        If there is no such expression, or not always a value.
    """

    def __init__(self, item: Parameter, parameters: Mapping[str, Parameter]) -> None:
        path = ("parameters", item.name)
        numbers = tuple(name for name, other in parameters.items() if not other.is_text)
        expression = str(item.tied_to)
        self._expression = named_expression(expression, numbers, "number", *path, TIED_TO)
        self._is_integer = item.is_integer
        for name in sorted(self._expression.names):
            other = parameters[name]
            if other.is_derived:
                raise StudyError(f"'{name}' is itself computed from others", (*path, TIED_TO))
            if other.when and other.when != item.when:
                raise StudyError(
                    f"'{name}' is there only when {other.when}; expected the same `when`",
                    (*path, TIED_TO),
                )
        if item.bounds is None and item.is_integer:
            raise StudyError("missing; an integer that is computed has them", (*path, "bounds"))
        kept = f"{item.name} == {expression}"
        if item.bounds is not None:
            kept = f"{item.bounds[0]} <= {item.name} <= {item.bounds[1]}"
        self.condition = Condition(kept, parameters, *path, TIED_TO)

    def values(self, columns: Mapping[str, Array]) -> Array:
        """Return the values (n,), or one for all, for those of other parameters by their names."""
        values = self._expression({name: columns[name] for name in self._expression.names})
        return np.floor(values + 0.5) if self._is_integer else values
