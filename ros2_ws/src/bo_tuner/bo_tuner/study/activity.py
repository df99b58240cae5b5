"""Which parameters a parameter set has: one with a condition, ``when``, only where that holds.

A parameter is active if its condition holds and all parameters that this names are active, as in
the conditional spaces of Hutter, Hoos and Leyton-Brown (2011, LION 5). An inactive one has its
default for the models, so sets that differ in nothing else are the same.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.conditions import FEWEST, Condition, shown_share
from bo_tuner.study.parameter import WHEN, Parameter
from bo_tuner.study.titles import titled_values
from bo_tuner.trials import Value


class Activity:
    """The conditions under which parameters are active.

    Parameters
    ----------
    parameters : mapping from str to Parameter
        The study's, by name.

    Attributes
    ----------
    names : tuple of str
        Parameters with a condition, each after those that its condition depends on.

    Raises
    ------
    StudyError
        If a condition is none, or depends on its own parameter.
    """

    def __init__(self, parameters: Mapping[str, Parameter]) -> None:
        self._parameters = parameters
        self._conditions: dict[str, Condition] = {}
        for name, item in parameters.items():
            if item.when:
                with under("parameters", name, WHEN):
                    self._conditions[name] = Condition(item.when, parameters)
        names: dict[str, None] = {}
        for name in self._conditions:
            self._add(name, names, ())
        self.names = tuple(names)

    def holds(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Return for each of `names` whether it is active: 1, 0, or NaN if that is not known.

        Parameters
        ----------
        columns : mapping from str to array
            By parameter its values (n,), or one for all; of a text the positions of its values;
            NaN where it is not known.
        """
        active: dict[str, Array] = {}
        for name in self.names:
            condition = self._conditions[name]
            conjuncts = [condition.values(columns)]
            conjuncts += [active[other] for other in condition.names if other in active]
            parts = np.broadcast_arrays(*conjuncts)
            # Not active as soon as one of them does not hold, whatever is not known.
            unknown = np.where(np.isnan(parts).any(axis=0), np.nan, 1.0)
            active[name] = np.where(np.equal(parts, 0.0).any(axis=0), 0.0, unknown)
        return active

    def branch(self, active: Mapping[str, Value]) -> str:
        """Return the branch of a parameter set in words, such as ``planner mppi, horizon > 20``.

        It is told by the choices that conditions name, and by the conditions on numbers that hold.

        Parameters
        ----------
        active : mapping from str to value
            The parameters that the set has.
        """
        named = dict.fromkeys(name for c in self._conditions.values() for name in c.names)
        choices = [name for name in named if not self._parameters[name].is_number]
        numeric = [
            condition.text
            for name, condition in self._conditions.items()
            if name in active and not set(condition.names) <= set(choices)
        ]
        chosen = [name for name in choices if name in active]
        values = {name: active[name] for name in chosen}
        return ", ".join(
            filter(None, (titled_values(self._parameters, values), *dict.fromkeys(numeric)))
        )

    def never_active(self) -> list[str]:
        """Return the names of those that fixed parameters alone keep from being active."""
        columns = {name: np.array([np.nan]) for name in self._parameters}
        for name, item in self._parameters.items():
            constant = item.leader(self._parameters).fixed
            if constant is not None:
                # A fixed text has one value only, at position 0.
                columns[name] = np.array([0.0 if isinstance(constant, str) else float(constant)])
        return [name for name, active in self.holds(columns).items() if active[0] == 0.0]

    def _add(self, name: str, names: dict[str, None], path: tuple[str, ...]) -> None:
        if name in path:
            way = " which depends on ".join(map(checks.quoted, (*path[path.index(name) :], name)))
            raise StudyError(f"depends on itself: {way}", ("parameters", name, WHEN))
        if name in names:
            return
        for other in self._conditions[name].names:
            for each in {other, self._parameters[other].leader(self._parameters).name}:
                if each in self._conditions:
                    self._add(each, names, (*path, name))
        names[name] = None


def check_reach(conditional: Iterable[tuple[Parameter, NDArray[np.bool_]]]) -> None:
    """Refuse tuned parameters that hardly any parameter set has.

    Parameters
    ----------
    conditional
        Each with whether permitted parameter sets, drawn within the bounds, have it; shape (n,).

    Raises
    ------
    StudyError
        With the first of them.
    """
    for item, active in conditional:
        share = float(active.mean()) if len(active) else 0.0
        if share < FEWEST:
            raise StudyError(
                f"{checks.quoted(item.when)} holds for {shown_share(share)} of the permitted "
                f"parameter sets; expected at least {100.0 * FEWEST:g} %",
                ("parameters", item.name, WHEN),
            )
