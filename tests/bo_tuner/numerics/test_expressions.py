"""Expressions between signals: right on arrays, and nothing but arithmetic."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.numerics.expressions import Expression, ExpressionError, UnknownNameError

X = np.array([-2.0, -0.5, 0.0, 1.5])
Y = np.array([1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x - y", X - Y),
        ("-x ** 2 + 3 * y / 2", -(X**2) + 1.5 * Y),
        ("abs(x) % 2", np.abs(X) % 2),
        ("hypot(x, y)", np.sqrt(X**2 + Y**2)),
        ("max(min(x, 1), -1)", np.clip(X, -1, 1)),
        ("x > 0", [0, 0, 0, 1]),
        ("-1 < x < 1", [0, 1, 1, 0]),
        ("x < -1 or y >= 4", [1, 0, 0, 1]),
        ("x < 0 and not y > 1", [1, 0, 0, 0]),
        ("x == 0 or x != 0 and y < 2", [1, 0, 1, 0]),
        ("3", 3.0),
        (" x ", X),
    ],
)
def test_arithmetic_on_arrays(text, expected):
    np.testing.assert_allclose(Expression(text, ("x", "y"))({"x": X, "y": Y}), expected)


def test_what_is_not_defined_is_not_finite():
    np.testing.assert_array_equal(Expression("1 / x", ("x",))({"x": [0.0, 2.0]}), [np.inf, 0.5])
    assert np.isnan(Expression("sqrt(x)", ("x",))({"x": -1.0}))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("u > 0", np.nan),
        ("not u > 0", np.nan),
        ("u != u", np.nan),
        ("0 < u < 1", np.nan),
        ("u > 0 or y > 0", 1),
        ("u > 0 or y < 0", np.nan),
        ("u > 0 and y < 0", 0),
        ("y > 0 and u > 0", np.nan),
        ("not (u > 0 and y < 0)", 1),
        ("2 < 1 < u", 0),
        ("u or 3", 1),
        ("not u", np.nan),
    ],
)
def test_what_is_not_known_decides_nothing(text, expected):
    """Kleene's strong logic, with u unknown."""
    found = Expression(text, ("u", "y"))({"u": np.full(4, np.nan), "y": Y})
    np.testing.assert_array_equal(np.broadcast_to(found, 4), np.full(4, expected))


def test_the_names_that_it_has():
    assert Expression("abs(x) + min(z, x)", ("x", "y", "z")).names == {"x", "z"}


@pytest.mark.parametrize("text", ["speed - x", "cosh(x)", "x(1)", "abs", "__import__('os')", "t"])
def test_unknown_names(text):
    with pytest.raises(UnknownNameError):
        Expression(text, ("x",))


@pytest.mark.parametrize(
    "text",
    [
        "", "x +", "x; x", "x = 1", "import os", "x.real", "x[0]", "(x).__class__", "[x]", "(x, x)",
        "{x: 1}", "lambda: x", "x if x else x", "[v for v in x]", "'x' * 9", "f'{x}'", "True", "1j",
        "x in x", "x is x", "x @ x", "x << 3", "x & 1", "~x", "abs()", "abs(x, x, x, x)",
        "min(*x)", "max(x, axis=0)", "abs(x, out=x)", "(y := x)", "await x", "x" * 600,
        "(" * 400 + "x" + ")" * 400 , "-" * 499 + "x" * 2, "9" * 400,
    ],
)  # fmt: skip
def test_anything_else_is_refused_in_one_line(text):
    with pytest.raises(ExpressionError) as caught:
        Expression(text, ("x",))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x => 40", "not an expression: expected >= instead of => at character 3"),
        ("x > 1 && y", "not an expression: expected and instead of && at character 7"),
        ("x || y", "not an expression: expected or instead of || at character 3"),
        ("x != 1 and !y", "not an expression: expected not instead of ! at character 12"),
        ("x >= 1 AND y == 2", "not an expression: expected and instead of AND at character 8"),
        ("x = 1", "not an expression: expected == instead of = at character 3"),
        ("x > 1; y", "not an expression at character 6, ';'"),
        ("x >", "not an expression: something is missing at its end"),
        ("(x\n* > 2)", "not an expression in its line 2"),
        # NumPy would take a further one as the place of the result.
        ("max(abs(x), abs(y), 2) > 2", "max takes 2 arguments, found 3"),
        ("min(x)", "min takes 2 arguments, found 1"),
        ("hypot(x, y, x)", "hypot takes 2 arguments, found 3"),
        ("x + abs(x, y)", "abs takes 1 argument, found 2"),
    ],
)
def test_the_place_of_a_mistake(text, complaint):
    with pytest.raises(ExpressionError) as caught:
        Expression(text, ("x", "y"))
    assert str(caught.value) == complaint


def test_a_huge_power_takes_no_time():
    assert np.isinf(Expression("9 ** 9 ** 9 ** 9", ())({}))


@given(st.text(alphabet="xy()+-*/<>=. 019andor,_[]:'", max_size=40))
def test_a_text_is_evaluated_or_refused(text):
    with contextlib.suppress(ExpressionError):
        assert Expression(text, ("x", "y"))({"x": X, "y": Y}).dtype == float


LEVELS = {"gains.kp": np.array([1.0, 3.0]), "limits[1]": 2.0, "x": 0.0}


class TestNamesWithLevels:
    def test_levels_and_items_are_one_name(self):
        found = Expression("gains.kp + x <= limits[1]", tuple(LEVELS))
        assert found.names == {"gains.kp", "limits[1]", "x"}
        np.testing.assert_array_equal(found(LEVELS), [1.0, 0.0])

    @pytest.mark.parametrize(
        ("text", "name"), [("gains.ki < 1", "gains.ki"), ("limits[2] < 1", "limits[2]")]
    )
    def test_unknown_ones_are_named_in_full(self, text, name):
        with pytest.raises(UnknownNameError) as error:
            Expression(text, tuple(LEVELS))
        assert (error.value.name, error.value.known) == (name, tuple(LEVELS))


def test_what_is_infinite_may_be_unknown():
    """As in conditions on parameters, where 1/0 is a mistake."""
    values = {"x": np.array([0.0, 0.5, 4.0])}
    np.testing.assert_array_equal(Expression("1 <= 1 / x", ("x",))(values), [1.0, 1.0, 0.0])
    finite = Expression("1 <= 1 / x", ("x",), finite=True)
    np.testing.assert_array_equal(finite(values), [np.nan, 1.0, 0.0])


def test_a_text_that_is_too_deep_is_an_error_of_its_own():
    """Or is evaluated, where the interpreter goes so deep."""
    with contextlib.suppress(ExpressionError):
        value = Expression("-" * 499 + "x", ("x", "gains.kp"))({"x": 1.0})
        assert value == -1.0
