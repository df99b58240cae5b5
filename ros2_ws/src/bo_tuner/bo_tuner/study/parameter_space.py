"""The parameters of a study together: ties, fixed values, order, conditions, and what is active."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.errors import ConditionError, ParameterError, StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.activity import Activity
from bo_tuner.study.conditions import KEY, Condition
from bo_tuner.study.derived import Derived
from bo_tuner.study.equality import Equality, equality_of
from bo_tuner.study.ordering import PartialOrder
from bo_tuner.study.parameter import Parameter
from bo_tuner.text import values as values_in_words
from bo_tuner.trials import Value


class ParameterSpace:
    """Maps a parameter set, by name, to a row of its d tuned values, and back.

    Parameters
    ----------
    parameters : iterable of Parameter
        All parameters; the tuned ones become the columns of a row, in this order.
    order : sequence of (str, str)
        Names (a, b) of parameters with a <= b.
    where : sequence of str
        Conditions that hold in every parameter set.

    Attributes
    ----------
    parameters : tuple of Parameter
        All parameters.
    order : tuple of (str, str)
        As given.
    conditions : tuple of Condition
        Those of `where`.
    tuned : tuple of Parameter
        The tuned ones.
    names : tuple of str
        Names of the tuned ones.
    lower, upper : ndarray, shape (d,)
        Bounds of the tuned parameters in the study, in their own units.
    permitted : tuple of two ndarrays, shape (d,)
        These bounds, tightened by the order.
    partial_order : PartialOrder
        Order constraints between columns.
    equalities : list of Equality
        Those of `where` that are kept exactly; the parameters that follow from them are no columns.
    defaults : dict from str to bool, int, float or str
        Hand-tuned value of every parameter.

    Raises
    ------
    StudyError
        If a reference is unknown, no parameter is tuned, a condition depends on its own parameter,
        or the order cannot be satisfied or is violated by the defaults.
    """

    def __init__(
        self,
        parameters: Iterable[Parameter],
        order: Sequence[tuple[str, str]],
        where: Sequence[str] = (),
    ) -> None:
        self.parameters = tuple(parameters)
        self.order = tuple(order)
        self._by_name = {item.name: item for item in self.parameters}
        if len(self._by_name) != len(self.parameters):
            raise StudyError("two parameters have the same name", ("parameters",))
        if not any(item.is_tuned for item in self.parameters):
            raise StudyError("no parameter is tuned; give one bounds", ("parameters",))
        self._check_ties()
        self.equalities = self._equalities(where)
        dependent = [each.dependent for each in self.equalities]
        self.tuned = tuple(i for i in self.parameters if i.is_tuned and i.name not in dependent)
        self.activity = Activity(self._by_name)
        self.names = tuple(item.name for item in self.tuned)
        self._column = {name: column for column, name in enumerate(self.names)}
        # Of a parameter that is no number, a column holds the position among its levels.
        bounds = np.array(
            [item.bounds or (0, len(item.levels) - 1) for item in self.tuned], dtype=np.float64
        )
        self.lower, self.upper = bounds[:, 0], bounds[:, 1]
        self.defaults: dict[str, Value] = {}
        for item in self.parameters:
            default = self._leader(item.name).default
            if default is not None:
                self.defaults[item.name] = default
        self._derived = {
            item.name: Derived(item, self._by_name) for item in self.parameters if item.is_derived
        }
        self._computed = [
            item.name
            for item in self.parameters
            if item.is_derived or self._leader(item.name).name in dependent
        ]
        self.permitted = (self.lower, self.upper)
        self.partial_order = PartialOrder(len(self.tuned), ())
        for index, names in enumerate(self.order):
            self._add_order(index, names)
        conditions = []
        exact = [each.path for each in self.equalities]
        for index, text in enumerate(where):
            if (KEY, index) in exact:
                continue
            with under(KEY, index):
                conditions.append(Condition(text, self._by_name, KEY, index))
        self.conditions = (*conditions, *(item.condition for item in self._derived.values()))
        self._default = np.array([self._number_of(item, item.default) for item in self.tuned])
        complete = self.complete(self._default)
        for each in self.equalities:
            default, follows = (float(d[each.dependent]) for d in (self.defaults, complete))
            each.check_default(default, follows)
        self.defaults = {name: complete[name] for name in self._by_name}

    def row(self, parameters: Mapping[str, checks.ParameterValue]) -> Array:
        """Return the tuned values of a parameter set in their own units, shape (d,).

        Tied and fixed parameters may be left out, and conditional ones: those that are not active
        have their defaults, whatever is given.

        Raises
        ------
        ParameterError
            If a tuned parameter is missing, of a wrong type or out of bounds, or a name is unknown.
        """
        for name in parameters:
            if name not in self._by_name:
                raise ParameterError(
                    f"{name}: unknown parameter; {checks.suggestion(str(name), self._by_name)}"
                )
        row = self._default.copy()
        for column, item in enumerate(self.tuned):
            if item.name not in parameters and item.when:
                continue
            if item.name not in parameters:
                raise ParameterError(f"{item.name}: missing")
            try:
                value = item.checked(parameters[item.name])
            except StudyError as error:
                raise ParameterError(f"{item.name}: {error}") from None
            row[column] = self._number_of(item, value)
            if not self.lower[column] <= row[column] <= self.upper[column]:
                raise ParameterError(
                    f"{item.name}: {parameters[item.name]} lies outside the bounds {item.bounds}"
                )
        canonical: Array = self.canonical(row[None])[0]
        return canonical

    def active(self, values: Array) -> dict[str, NDArray[np.bool_]]:
        """Return for each conditional parameter in which rows (n, d) it is active, shape (n,)."""
        if not self.activity.names:
            return {}
        holds = self.activity.holds(self.columns(values))
        return {name: np.broadcast_to(of == 1.0, len(values)) for name, of in holds.items()}

    def log_prior(self, values: Array) -> Array:
        """Return the logarithm of the prior density of rows (n, d), (n,), 0 where it is largest.

        A parameter that is not active counts as if it were uniform.
        """
        columns, active, density = self.columns(values), self.active(values), np.zeros(len(values))
        for item in self.parameters:
            if item.prior is not None and item.bounds is not None:
                own = item.prior.log_density(columns[item.name])
                absent = item.prior.log_uniform(*map(float, item.bounds))
                density += np.where(active.get(item.name, True), own, absent)
        return density

    def canonical(self, values: Array) -> Array:
        """Return rows of tuned values (n, d) with the defaults of what is not active."""
        rows = values
        for name, active in self.active(values).items():
            column = self._column.get(name)
            if column is not None:
                rows = rows.copy() if rows is values else rows
                rows[~active, column] = self._default[column]
        return rows

    def check_order(self, row: Array) -> None:
        """Refuse a row of tuned values, shape (d,), that violates the order.

        Raises
        ------
        ParameterError
            With the two parameters.
        """
        values = self.complete(row)
        for smaller, larger in self.order:
            if float(values[smaller]) > float(values[larger]):
                raise ParameterError(
                    f"expected '{smaller}' <= '{larger}', found {values[smaller]} and "
                    f"{values[larger]}"
                )

    def held(self, values: Array) -> Array:
        """Return whether each condition holds in rows of tuned values (n, d): 1, 0, or NaN.

        NaN is for a condition that is not defined there. One of a parameter that is not active
        holds. The shape is (number of conditions, n).
        """
        columns, active = self.columns(values), self.active(values)
        held = np.empty((len(self.conditions), len(values)))
        for index, condition in enumerate(self.conditions):
            held[index] = condition.values(columns)
            for name in condition.names:
                if name in active:
                    held[index, ~active[name]] = 1.0
        return held

    def holds(self, values: Array) -> NDArray[np.bool_]:
        """Return which rows of tuned values (n, d) satisfy all conditions, shape (n,)."""
        if not self.conditions:
            return np.ones(len(values), dtype=np.bool_)
        satisfied: NDArray[np.bool_] = (self.held(values) == 1.0).all(axis=0)
        return satisfied

    def check_conditions(self, row: Array) -> None:
        """Refuse a row of tuned values, shape (d,), that breaks a condition.

        Raises
        ------
        ConditionError
            With the condition and the values.
        """
        for equality in self.equalities:
            if not equality.holds(row[None, self.columns_of(equality)])[0]:
                others = values_in_words({n: float(row[self._column[n]]) for n in equality.names})
                raise ConditionError(
                    equality.text, f"{others} leave nothing within bounds to {equality.dependent}"
                )
        for condition, value in zip(self.conditions, self.held(row[None])[:, 0], strict=True):
            if value != 1.0:
                shown = condition.values_in_words(self.complete(row))
                if np.isnan(value):
                    shown = f"it is not defined for {shown}"
                raise ConditionError(condition.text, shown)

    def on_equalities(self, values: Array) -> Array:
        """Return rows of tuned values (n, d), moved to where all equalities hold."""
        rows = values
        for each in self.equalities:
            columns = self.columns_of(each)
            rows = rows.copy() if rows is values else rows
            rows[:, columns] = each.nearest(rows[:, columns])
        return rows

    def columns_of(self, equality: Equality) -> list[int]:
        """Return the columns of the free parameters of an equality."""
        return [self._column[name] for name in equality.names]

    def complete(self, row: Array) -> dict[str, Value]:
        """Return all parameters by name for a row of tuned values, shape (d,), in own units."""
        parameters = dict(self.defaults)
        for item in self.parameters:
            column = self._column.get(self._leader(item.name).name)
            if column is not None:
                value = float(row[column])
                levels = self.tuned[column].levels
                if levels:
                    parameters[item.name] = levels[int(value)]
                else:
                    parameters[item.name] = int(value) if item.is_integer else value
        columns = self.columns(row[None]) if self._computed else {}
        for name in self._computed:
            value = float(columns[name].item())
            # One that is not defined is told by its condition.
            whole = self._by_name[name].is_integer and np.isfinite(value)
            parameters[name] = int(value) if whole else value
        return parameters

    def inactive(self, row: Array) -> frozenset[str]:
        """Return the names of the parameters that are not active in a row, shape (d,)."""
        return frozenset(name for name, of in self.active(row[None]).items() if not of[0])

    @staticmethod
    def _number_of(item: Parameter, value: Value | None) -> float:
        """Return what the column of a tuned parameter holds for a value."""
        return float(item.levels.index(value) if item.levels else value)  # type: ignore[arg-type]

    def columns(self, values: Array) -> dict[str, Array]:
        """Return the values of all parameters in rows (n, d), as a `Condition` takes them."""
        given = (item for item in self.parameters if item.name not in self._computed)
        columns = {item.name: self._column_of(item, values) for item in given}
        for equality in self.equalities:
            columns[equality.dependent] = equality.values(columns)
        for name in self._computed:
            if name not in self._derived:
                columns[name] = columns[self._leader(name).name]
        return columns | {name: each.values(columns) for name, each in self._derived.items()}

    def _column_of(self, item: Parameter, values: Array) -> Array:
        """Return the values (n,) of a parameter in rows (n, d), or the one (1,) that all have."""
        column = self._column.get(self._leader(item.name).name)
        if column is not None:
            tuned: Array = values[:, column]
            leader = self.tuned[column]
            if leader.levels and item.type in ("double", "integer"):
                tuned = np.asarray(leader.levels, dtype=np.float64)[np.rint(tuned).astype(int)]
            return tuned
        fixed = self.defaults[item.name]
        # A fixed text has one level only, at position 0.
        return np.array([0.0 if isinstance(fixed, str) else float(fixed)])

    def _leader(self, name: str) -> Parameter:
        return self._by_name[name].leader(self._by_name)

    def _equalities(self, where: Sequence[str]) -> list[Equality]:
        found: list[Equality] = []
        in_order = {self._leader(n).name for pair in self.order for n in pair if n in self._by_name}
        for index, text in enumerate(where):
            with under(KEY, index):
                equality = equality_of(checks.text(text), index, self._by_name)
                if equality is None:
                    continue
                members = {*equality.names, equality.dependent}
                others = {name for each in found for name in (*each.names, each.dependent)}
                for name in sorted(members & (in_order | others)):
                    where_else = "`order`" if name in in_order else "another equality"
                    raise StudyError(f"'{name}' is in {where_else} as well; expected it in one")
                found.append(equality)
        return found

    def _check_ties(self) -> None:
        for item in self.parameters:
            if item.tied_to is None or item.is_derived:
                continue
            path = ("parameters", item.name, "tied_to")
            others = [name for name in self._by_name if name != item.name]
            checks.reference(item.tied_to, "other parameter", others, *path)
            leader = self._by_name[item.tied_to]
            if leader.tied_to is not None:
                raise StudyError(f"'{leader.name}' is itself tied to '{leader.tied_to}'", path)
            if leader.type != item.type:
                raise StudyError(f"'{leader.name}' is of type {leader.type}, not {item.type}", path)
            if leader.when and leader.when != item.when:
                raise StudyError(
                    f"'{leader.name}' is there only when {leader.when}; expected the same `when`",
                    path,
                )
            if leader.choices is not None and item.default is not None:
                leader.checked(item.default, "parameters", item.name, "default")
            if item.default is not None and item.default != leader.default:
                raise StudyError(
                    f"{item.default} differs from {leader.default}, the default of "
                    f"'{leader.name}' to which it is tied",
                    ("parameters", item.name, "default"),
                )

    def _add_order(self, index: int, names: tuple[str, str]) -> None:
        path = ("order", index)
        for place, name in enumerate(names):
            checks.reference(name, "parameter", self._by_name, *path, place)
        leaders = [self._leader(name) for name in names]
        rule = f"'{names[0]}' <= '{names[1]}'"
        if names[0] == names[1]:
            raise StudyError(f"'{names[0]}' is compared with itself", path)
        if leaders[0].type != leaders[1].type:
            raise StudyError(f"'{names[0]}' and '{names[1]}' are of different types", path)
        if self._by_name[names[0]].when != self._by_name[names[1]].when:
            raise StudyError(
                f"{rule} has a parameter that is not always there; expected it in `where`, which "
                "counts while all of its parameters are",
                path,
            )
        for name, item in zip(names, leaders, strict=True):
            if item.is_derived:
                raise StudyError(f"'{name}' is computed; expected it in `where`", path)
            if not item.is_number:
                what = "has choices" if item.choices else f"is a {item.type}"
                raise StudyError(f"'{name}' {what}, and is compared with no other", path)
            if item.step is not None:
                raise StudyError(f"'{name}' has a step; a parameter with an order has none", path)
        lower, upper = (bounds.copy() for bounds in self.permitted)
        i, j = (self._column.get(item.name) for item in leaders)
        if i is not None and j is not None:
            if i != j and self.partial_order.implies(j, i):
                raise StudyError(f"{rule} closes a cycle; use tied_to for equal values", path)
            pairs = [*self.partial_order.pairs, (i, j)]
            # Values tied to each other always satisfy it.
            self.partial_order = PartialOrder(len(self.tuned), [p for p in pairs if p[0] != p[1]])
        elif i is not None:
            upper[i] = min(upper[i], float(self.defaults[names[1]]))
        elif j is not None:
            lower[j] = max(lower[j], float(self.defaults[names[0]]))
        self.permitted = low, high = self.partial_order.tighten(lower, upper)
        if np.any(low > high):
            raise StudyError(f"the bounds leave no values with {rule}", path)
        first, second = (self.defaults[name] for name in names)
        if float(first) > float(second):
            raise StudyError(f"expected {rule}, found the defaults {first} and {second}", path)
