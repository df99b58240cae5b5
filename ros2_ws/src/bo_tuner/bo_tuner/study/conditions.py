"""Conditions on the parameters of a set, such as ``ki <= kp / 2``.

A parameter set is permitted if all conditions hold. A condition that is not defined, for example by
a division by zero, does not hold.
"""

import ast
import contextlib
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.expressions import Expression
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.signals import named_expression
from bo_tuner.trials import Value

KEY = "where"

FEWEST = 1e-4
"""Least share of the parameter sets within the bounds that satisfies the conditions together."""


class Condition:
    """A condition between parameters.

    Parameters
    ----------
    text : str
        The expression. A boolean is 1 or 0; a text can be compared by ``==`` and ``!=`` with what
        it may be, in quotes.
    parameters : mapping from str to Parameter
        The study's, by name.
    path : str or int
        Place in the study.

    Attributes
    ----------
    text : str
        As given.
    path : tuple of str or int
        As given.
    names : tuple of str
        Parameters in it.

    Raises
    ------
    StudyError
        If it is no condition between parameters.
    """

    def __init__(self, text: object, parameters: Mapping[str, Parameter], *path: str | int) -> None:
        self.path = path
        self.text = checks.text(text).strip()
        self._expression = _expression(self.text, parameters)
        self.names = tuple(name for name in parameters if name in self._expression.names)
        if not self.names:
            raise StudyError(f"there is no parameter in {checks.quoted(self.text)}")

    def values(self, columns: Mapping[str, Array]) -> Array:
        """Return 1 where it holds, 0 where not, NaN where it is not defined, each of shape (n,).

        Parameters
        ----------
        columns : mapping from str to array
            By parameter its values (n,), or one for all; of a text the positions of its values.
        """
        return self._expression({name: columns[name] for name in self.names})

    def values_in_words(self, parameters: Mapping[str, Value]) -> str:
        """Return the values that a parameter set has in it, as ``ki 3 and kp 2``."""
        *others, last = (f"{name} {_shown(parameters[name])}" for name in self.names)
        return f"{', '.join(others)} and {last}" if others else last


def check_shares(conditions: Sequence[Condition], held: Array) -> None:
    """Refuse conditions that hardly any parameter set within the bounds satisfies.

    Parameters
    ----------
    conditions
        The conditions.
    held
        Of each condition, for n parameter sets that are drawn within the bounds, 1 where it holds,
        0 where not, NaN where it is not defined; shape (number of conditions, n).

    Raises
    ------
    StudyError
        With the conditions, one or several together, that leave too little, and the share left.
    """
    holds: NDArray[np.bool_] = held == 1.0
    for index, condition in enumerate(conditions):
        if np.isnan(held[index]).all():
            raise StudyError(
                f"'{condition.text}' is not defined for any parameter set within the bounds; "
                "is there a division by zero?",
                condition.path,
            )
    indices = range(len(conditions))
    sizes = (1, 2, len(conditions))
    for chosen in (group for size in sizes for group in combinations(indices, size)):
        share = float(holds[list(chosen)].all(axis=0).mean())
        if share >= FEWEST:
            continue
        named = " and ".join(f"'{conditions[index].text}'" for index in chosen)
        verb = "holds" if len(chosen) == 1 else "hold together"
        raise StudyError(
            f"{named} {verb} for {shown_share(share)} of the parameter sets within the bounds, of "
            f"which {holds.shape[1]} were drawn; expected at least {100.0 * FEWEST:g} % (for equal "
            "values use tied_to)",
            conditions[chosen[-1]].path,
        )


def shown_share(share: float) -> str:
    """Return a share that is too small, in words."""
    return f"only {100.0 * share:.2g} %" if share else "none"


class _Positions(ast.NodeTransformer):
    """Puts positions in the place of texts that parameters are compared with.

    Parameters
    ----------
    levels
        The values of each parameter that is text, by its name.
    """

    def __init__(self, levels: Mapping[str, tuple[str, ...]]) -> None:
        self._levels = levels

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        if len(node.ops) == 1 and isinstance(node.ops[0], (ast.Eq, ast.NotEq)):
            sides = (node.left, node.comparators[0])
            for name, text in (sides, sides[::-1]):
                levels = self._levels.get(ast.unparse(name))
                if levels and isinstance(text, ast.Constant) and isinstance(text.value, str):
                    return ast.Compare(
                        name, node.ops, [ast.Constant(_position(text.value, levels))]
                    )
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return self._refused(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        return self._refused(node)

    def _refused(self, node: ast.expr) -> ast.AST:
        name = ast.unparse(node)
        if name in self._levels:
            known = " or ".join(repr(level) for level in self._levels[name])
            raise StudyError(f"'{name}' is a text; compare it by == or != with {known}")
        return node


def _expression(text: str, parameters: Mapping[str, Parameter]) -> Expression:
    """Return the expression of a condition between parameters, with positions in place of texts."""
    levels = {name: _levels(item, parameters) for name, item in parameters.items()}
    texts = {name: choices for name, choices in levels.items() if choices}
    tree: ast.Expression | None = None
    # A text that is no expression is refused below, by `named_expression`.
    with contextlib.suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        tree = ast.parse(text, mode="eval")
    with contextlib.suppress(RecursionError):
        if tree is not None and texts:
            tree = _Positions(texts).visit(tree)
            text = ast.unparse(tree)
        if tree is not None and not _is_condition(tree.body, parameters):
            raise StudyError(f"expected a condition such as ki <= kp / 2, found {text!r}")
    return named_expression(text, tuple(parameters), "parameter", finite=True)


def _is_condition(node: ast.expr, parameters: Mapping[str, Parameter]) -> bool:
    """Whether an expression is a condition, which holds or not, and no number."""
    if isinstance(node, ast.BoolOp):
        return all(_is_condition(part, parameters) for part in node.values)
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.Not) and _is_condition(node.operand, parameters)
    item = parameters.get(ast.unparse(node))
    return isinstance(node, ast.Compare) or (item is not None and item.type == "boolean")


def _levels(item: Parameter, parameters: Mapping[str, Parameter]) -> tuple[str, ...]:
    """Return the values that a text parameter may have; empty if it is no text."""
    if not item.is_text:
        return ()
    leader = item.leader(parameters)
    return tuple(map(str, leader.choices or (leader.fixed,)))


def _position(text: str, levels: tuple[str, ...]) -> int:
    """Return the position of a text among those that a parameter may be; -1 if it is fixed."""
    if len(levels) == 1:
        # It may have been one of several, and fixed since.
        return 0 if text == levels[0] else -1
    return levels.index(checks.choice(text, levels))


def _shown(value: Value) -> str:
    return repr(value) if isinstance(value, str) else checks.show(value)
