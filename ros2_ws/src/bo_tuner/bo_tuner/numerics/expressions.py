"""Expressions between signals, such as ``abs(setpoint - position) > 0.1 and t > 2``.

simpleeval walks Python's syntax tree and knows numbers, names, calls of named functions and
operators, and nothing else: no attributes, no items, no statements. Its own operators are for
single numbers; ours work item by item on arrays, ``and``, ``or``, ``not`` and chains such as
``0 < x < 1`` included.

A comparison with NaN is neither true nor false but unknown, and so is its ``not``; ``and`` and
``or`` are known where the other side decides (Kleene 1952, §64, the strong three-valued logic).
"""

import ast
import re
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import numpy as np
import simpleeval
from numpy.typing import ArrayLike

from bo_tuner.numerics.arrays import Array
from bo_tuner.text import one_line

LONGEST = 500
"""Characters of an expression."""


def _known(compare: Callable[..., Any]) -> Callable[..., Any]:
    """Return a comparison that is NaN where one of its sides is."""

    def compared(left: ArrayLike, right: ArrayLike) -> Array:
        unknown = np.isnan(left) | np.isnan(right)
        return np.where(unknown, np.nan, compare(left, right))

    return compared


def _not(value: ArrayLike) -> Array:
    return np.where(np.isnan(value), np.nan, np.equal(value, 0.0))


def _and(left: ArrayLike, right: ArrayLike) -> Array:
    decided = np.equal(left, 0.0) | np.equal(right, 0.0)
    return np.where(decided, 0.0, np.where(np.isnan(left) | np.isnan(right), np.nan, 1.0))


def _or(left: ArrayLike, right: ArrayLike) -> Array:
    return _not(_and(_not(left), _not(right)))


_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.Mod: np.mod,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
    ast.Not: _not,
    ast.Eq: _known(np.equal),
    ast.NotEq: _known(np.not_equal),
    ast.Lt: _known(np.less),
    ast.LtE: _known(np.less_equal),
    ast.Gt: _known(np.greater),
    ast.GtE: _known(np.greater_equal),
}
_NODES = (
    ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.Call, ast.Name, ast.Constant,
)  # fmt: skip
FUNCTIONS: dict[str, np.ufunc] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "sign": np.sign,
    "min": np.minimum,
    "max": np.maximum,
}
"""Functions that an expression may call, of one or two arguments."""


_OURS = {
    "=>": ">=", "=<": "<=", "<>": "!=", "=": "==",
    "&&": "and", "||": "or", "!": "not", "and": "and", "or": "or", "not": "not",
}  # fmt: skip
_FOREIGN = re.compile(
    r"=>|=<|<>|(?<![<>=!])=(?!=)|&&|\|\||!(?!=)|\b(?!and\b|or\b|not\b)(?i:and|or|not)\b"
)
"""Operators of other languages, as they stand where Python refuses the text."""


class ExpressionError(ValueError):
    """A text is no expression that can be evaluated; the message is one line."""


class UnknownNameError(ExpressionError):
    """An expression has a name that is not known."""

    def __init__(self, name: str, known: tuple[str, ...]) -> None:
        super().__init__(f"unknown name {name}")
        self.name = name
        self.known = known


class Expression:
    """A checked expression.

    Parameters
    ----------
    text
        The expression.
    names
        The names that it may have, also ones with levels such as ``gains.kp``, and items of arrays
        such as ``gains[2]``.
    finite
        Whether a comparison with what is infinite, such as 1/0, is not known either.

    Attributes
    ----------
    text : str
        The expression.
    names : frozenset of str
        The names that it does have.

    Raises
    ------
    ExpressionError
        If it cannot be evaluated.
    """

    def __init__(self, text: str, names: tuple[str, ...], *, finite: bool = False) -> None:
        if len(text) > LONGEST:
            raise ExpressionError(f"expected at most {LONGEST} characters")
        try:
            tree = ast.parse(text.strip(), mode="eval").body
            self._tree = _Joined(names).visit(tree)
        except SyntaxError as error:
            raise ExpressionError(_what_is_wrong(text.strip(), error)) from None
        except UnknownNameError:
            raise
        except (ValueError, RecursionError, MemoryError):
            raise ExpressionError("not an expression") from None
        self._finite = finite
        self.text = text
        calls = [node for node in ast.walk(self._tree) if isinstance(node, ast.Call)]
        called = {id(call.func) for call in calls}
        name_nodes = [n for n in ast.walk(self._tree) if isinstance(n, ast.Name)]
        for node in name_nodes:
            known = tuple(FUNCTIONS) if id(node) in called else names
            if node.id not in known:
                raise UnknownNameError(node.id, known)
        for call in calls:
            _check_arguments(call)
        self.names = frozenset(node.id for node in name_nodes if id(node) not in called)
        # Any other error, such as a missing argument, is raised by evaluating it with any numbers.
        self({name: np.ones(1) for name in self.names})

    def __call__(self, values: Mapping[str, ArrayLike]) -> Array:
        """Evaluate the expression item by item.

        Parameters
        ----------
        values
            Of each of its names, arrays (n,) or single numbers.

        Returns
        -------
        Array
            The values (n,); NaN or infinite where they are not defined, such as 1/0. Of a
            condition, 1 where it holds, 0 where it does not, and NaN where that is not known.

        Raises
        ------
        ExpressionError
            If it has parts that are not supported.
        """
        evaluator = simpleeval.SimpleEval(_OPERATORS, FUNCTIONS, dict(values))
        evaluator.nodes = {kind: evaluator.nodes[kind] for kind in _NODES} | {
            ast.Constant: _number,
            ast.BoolOp: lambda node: _all_or_any(evaluator, node),
            ast.Compare: lambda node: _compare(evaluator, node, self._finite),
        }
        try:
            with np.errstate(all="ignore"):
                value = evaluator.eval(self.text, previously_parsed=self._tree)
                return np.asarray(value, dtype=np.float64)
        except simpleeval.InvalidExpression as error:
            raise ExpressionError(one_line(str(error))) from None
        except (TypeError, ValueError, RecursionError) as error:
            raise ExpressionError(f"cannot be evaluated: {one_line(str(error))}") from None


class _Joined(ast.NodeTransformer):
    """Joins levels and items, such as ``gains.kp`` or ``gains[2]``, to one name if it is known."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._has_any = not all(map(str.isidentifier, names))

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        return self._joined(node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        return self._joined(node)

    def _joined(self, node: ast.expr) -> ast.AST:
        if not self._has_any:
            return node
        name = ast.unparse(node)
        if name not in self._names:
            raise UnknownNameError(name, self._names)
        return ast.copy_location(ast.Name(name, ast.Load()), node)


def _check_arguments(call: ast.Call) -> None:
    """Refuse another number of arguments: NumPy would write its result to a further one."""
    if not isinstance(call.func, ast.Name):
        return
    expected, given = FUNCTIONS[call.func.id].nin, len(call.args)
    if given != expected:
        noun = "argument" if expected == 1 else "arguments"
        raise ExpressionError(f"{call.func.id} takes {expected} {noun}, found {given}")


def _what_is_wrong(text: str, error: SyntaxError) -> str:
    """Return where a text is no expression, with Python's operator for one of another language."""
    if foreign := _FOREIGN.search(text):
        place, known = foreign.start() + 1, _OURS[foreign[0].lower()]
        return f"not an expression: expected {known} instead of {foreign[0]} at character {place}"
    if (error.lineno or 1) > 1:
        return f"not an expression in its line {error.lineno}"
    if error.offset and error.offset <= len(text):
        return f"not an expression at character {error.offset}, {text[error.offset - 1]!r}"
    return "not an expression: something is missing at its end"


def _number(node: ast.Constant) -> float:
    if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
        raise ExpressionError(f"expected a number instead of {node.value!r}")
    try:
        return float(node.value)
    except OverflowError:
        raise ExpressionError("a number is too large") from None


def _all_or_any(evaluator: Any, node: ast.BoolOp) -> Any:
    combine = _and if isinstance(node.op, ast.And) else _or
    return reduce(combine, [evaluator._eval(value) for value in node.values])


def _compare(evaluator: Any, node: ast.Compare, finite: bool) -> Any:
    sides = [evaluator._eval(side) for side in (node.left, *node.comparators)]
    if finite:
        sides = [np.where(np.isfinite(side), side, np.nan) for side in sides]
    results = []
    for operation, left, right in zip(node.ops, sides[:-1], sides[1:], strict=True):
        if type(operation) not in _OPERATORS:
            raise ExpressionError("compare numbers by <, <=, >, >=, == or !=")
        results.append(_OPERATORS[type(operation)](left, right))
    return reduce(_and, results)
