"""The parameter table: what it says, and what it refuses with which words."""

import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feed_axis_common.errors import FeedAxisError, SettingsError
from feed_axis_common.parameters import build, load_defaults, parameter, specifications


@dataclass(frozen=True)
class Table:
    count: int = parameter("samples", "How many", lower=1, upper=9)
    speed: float = parameter("m/s", "How fast", lower=-2, upper=2.5)
    levels: tuple[float, ...] = parameter("m", "Where", lower=0, upper=1)
    mode: str = parameter("", "Which way", choices=("up", "down"))
    label: str = parameter("", "What it is called")
    active: bool = parameter("", "Whether it moves")


GOOD = {
    "count": 3,
    "speed": 0.5,
    "levels": (0.1, 0.2),
    "mode": "up",
    "label": "axis",
    "active": True,
}


def test_good_values_are_kept():
    table = build(Table, GOOD)
    assert table == Table(3, 0.5, (0.1, 0.2), "up", "axis", True)


def test_a_whole_number_is_taken_for_a_float():
    table = build(Table, GOOD | {"speed": 2, "levels": [1, 0]})
    assert isinstance(table.speed, float)
    assert table.speed == 2.0
    assert table.levels == (1.0, 0.0)
    assert all(isinstance(item, float) for item in table.levels)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("count", 3.0, "3.0 is not an integer"),
        ("count", "3", "'3' is not an integer"),
        ("count", True, "True is not an integer"),
        ("count", None, "None is not an integer"),
        ("count", math.nan, "nan is not an integer"),
        ("count", 0, "0 is below the lower limit 1 samples"),
        ("count", 10, "10 is above the upper limit 9 samples"),
        ("speed", "1.0", "'1.0' is not a number"),
        ("speed", True, "True is not a number"),
        ("speed", None, "None is not a number"),
        ("speed", [1.0], "[1.0] is not a number"),
        ("speed", math.nan, "nan is not finite"),
        ("speed", math.inf, "inf is not finite"),
        ("speed", -math.inf, "-inf is not finite"),
        ("speed", 2.5000001, "2.5000001 is above the upper limit 2.5 m/s"),
        ("speed", -3, "-3 is below the lower limit -2 m/s"),
        ("levels", 1.0, "1.0 is not a list of at least one number"),
        ("levels", [], "[] is not a list of at least one number"),
        ("levels", "12", "'12' is not a list of at least one number"),
        ("levels", [0.5, "1"], "'1' is not a number"),
        ("levels", [0.5, math.nan], "nan is not finite"),
        ("levels", [0.5, 1.5], "1.5 is above the upper limit 1 m"),
        ("mode", "left", "'left' is not one of up, down"),
        ("mode", 1, "1 is not one of up, down"),
        ("label", 1, "1 is not a string"),
        ("active", 1, "1 is not true or false"),
        ("active", "true", "'true' is not true or false"),
        ("active", None, "None is not true or false"),
    ],
)
def test_a_bad_value_is_refused_by_name_value_and_rule(name, value, rule):
    with pytest.raises(SettingsError) as caught:
        build(Table, GOOD | {name: value})
    assert str(caught.value) == f"{name}: {rule}"


def test_unknown_and_missing_parameters_are_named():
    with pytest.raises(SettingsError, match="sped: unknown parameter; expected one of count, spe"):
        build(Table, GOOD | {"sped": 1.0})
    with pytest.raises(SettingsError, match="mode: missing"):
        build(Table, {name: value for name, value in GOOD.items() if name != "mode"})


def test_errors_are_builtin_errors_too():
    assert issubclass(SettingsError, ValueError)
    assert issubclass(SettingsError, FeedAxisError)


@given(st.floats())
def test_what_passes_lies_within_the_range(value):
    try:
        table = build(Table, GOOD | {"speed": value})
    except SettingsError:
        assert not -2 <= value <= 2.5
    else:
        assert -2 <= table.speed <= 2.5


def test_the_table_can_be_read_back():
    count, speed, levels, mode, label, active = specifications(Table)
    assert (count.name, count.kind, count.lower, count.upper) == ("count", int, 1, 9)
    assert count.description == "How many [samples]"
    assert (speed.kind, levels.kind, mode.kind, active.kind) == (float, tuple, str, bool)
    assert mode.choices == ("up", "down")
    assert label.description == "What it is called"


def test_defaults_are_read_from_a_file_in_ros_form(tmp_path):
    path = tmp_path / "defaults.yaml"
    path.write_text("/**:\n  ros__parameters:\n    speed: 1.5\n    count: 2\n")
    assert load_defaults(path) == {"speed": 1.5, "count": 2}
