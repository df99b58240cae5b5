"""The way of parameters from one set to the next: small steps, straight on the scales."""

import math

import numpy as np
import pytest
from signal_runs import signal_study

from bo_tuner.errors import StudyError
from bo_tuner.study.parameter_scale import LINEAR, LOG, SYMLOG
from bo_tuner.study.ramping import Ramp
from bo_tuner.study.straight_lines import between
from bo_tuner.study.study_file import study_from_mapping

DOUBLE = {"node": "servo", "type": "double", "bounds": [0.1, 10.0], "default": 1.0}
LOG_DOUBLE = DOUBLE | {"scale": "log"}


def make(parameters, ramp=0.4, node=None, **sections):
    """A study with so many seconds of a ramp: 0.4 s are four steps."""
    mapping = signal_study(
        nodes={"servo": {"node": "servo"} | (node or {})},
        parameters=parameters,
        run={"end": {"after": 2.0}} | ({} if ramp is None else {"ramp": ramp}),
    )
    return study_from_mapping(mapping | sections)


def way(study, first, last):
    """What is set on the node, one step after the other."""
    return [step["servo"] for step in Ramp(study).steps({"servo": first}, {"servo": last})]


def values(name, steps):
    return [step[name] for step in steps]


def test_a_double_goes_in_equal_steps():
    steps = way(make({"kp": DOUBLE}), {"kp": 1.0}, {"kp": 5.0})
    # The last one is what is wanted, and set as without a ramp.
    assert values("kp", steps) == [2.0, 3.0, 4.0]


def test_on_a_logarithmic_scale_by_equal_factors():
    steps = way(make({"kp": LOG_DOUBLE}), {"kp": 0.1}, {"kp": 10.0})
    assert values("kp", steps) == pytest.approx([10**-0.5, 1.0, 10**0.5])


def test_on_a_symlog_scale():
    (value,) = between(SYMLOG, 10.0, 0.0, 10.0, np.array([0.5]))
    # log(1 + 1000 v / 10) is half of log(1001).
    assert value == pytest.approx((math.sqrt(1001.0) - 1.0) / 100.0)


@pytest.mark.parametrize("scale", [LOG, SYMLOG])
def test_a_value_that_is_not_on_the_scale_is_left_on_a_line_of_values(scale):
    """As of a node that had -3 before the tuner came."""
    assert between(scale, 1.0, -3.0, 1.0, np.array([0.25, 0.75])).tolist() == [-2.0, 0.0]


@pytest.mark.parametrize("scale", [LINEAR, LOG, SYMLOG])
@pytest.mark.parametrize(("first", "last"), [(0.1, 0.3), (7.3, 0.1), (1e-5, 9.9)])
def test_it_never_turns_back_nor_goes_beyond(scale, first, last):
    shares = np.arange(1, 600) / 600
    line = [first, *between(scale, 10.0, first, last, shares).tolist(), last]
    assert line == sorted(line, reverse=first > last)


def test_the_largest_doubles_do_not_overflow():
    assert between(LINEAR, 0.0, -1.5e308, 1.5e308, np.array([0.5])).tolist() == [0.0]


@pytest.mark.parametrize(("seconds", "steps"), [(0.2, 2), (0.3, 3), (0.35, 4), (60, 600)])
def test_a_step_takes_a_tenth_of_a_second_at_most(seconds, steps):
    study = make({"kp": DOUBLE}, ramp=seconds)
    assert len(way(study, {"kp": 1.0}, {"kp": 2.0})) == steps - 1
    assert Ramp(study).period * steps == pytest.approx(seconds)


def test_without_a_ramp_there_are_no_steps():
    study = make({"kp": DOUBLE}, ramp=None)
    assert not Ramp(study)
    assert way(study, {"kp": 1.0}, {"kp": 5.0}) == []


def test_what_has_nothing_in_between_waits_for_the_end():
    parameters = {
        "kp": DOUBLE,
        "n": {"node": "servo", "type": "integer", "bounds": [1, 9], "default": 1},
        "on": {"node": "servo", "type": "boolean", "default": False},
        "mode": {"node": "servo", "type": "string", "choices": ["a", "b"], "default": "a"},
    }
    first = {"kp": 1.0, "n": 1, "on": False, "mode": "a"}
    study = make(parameters)
    assert way(study, first, {"kp": 5.0, "n": 9, "on": True, "mode": "b"}) == [
        {"kp": 2.0},
        {"kp": 3.0},
        {"kp": 4.0},
    ]
    assert way(study, first, first | {"n": 9, "mode": "b"}) == [], "nothing is waited for"


@pytest.mark.parametrize("had", [None, math.nan, "1.0", True])
def test_what_the_node_does_not_have_as_a_number_changes_at_the_end(had):
    study = make({"kp": DOUBLE, "kd": DOUBLE})
    first = {"kd": 1.0} | ({} if had is None else {"kp": had})
    assert way(study, first, {"kp": 2.0, "kd": 5.0}) == [{"kd": 2.0}, {"kd": 3.0}, {"kd": 4.0}]


def test_a_value_that_a_device_has_rounded_is_there():
    study = make({"kp": DOUBLE})
    assert way(study, {"kp": float(np.float32(0.3))}, {"kp": 0.3}) == []


def test_items_of_an_array_go_together_and_leave_the_others_alone():
    node = {"parameters": {"gains": [1.0, 2.0, 3.0]}}
    study = make({"gains[0]": DOUBLE, "gains[2]": DOUBLE}, node=node)
    steps = way(study, {"gains": [1.0, 2.0, 3.0]}, {"gains": (5.0, 2.0, 7.0)})
    assert values("gains", steps) == [(2.0, 2.0, 4.0), (3.0, 2.0, 5.0), (4.0, 2.0, 6.0)]


def test_a_tied_parameter_goes_with_the_one_that_it_follows():
    tied = {"node": "servo", "type": "double", "tied_to": "kp"}
    study = make({"kp": LOG_DOUBLE, "ky": tied})
    steps = way(study, {"kp": 0.1, "ky": 0.1}, {"kp": 10.0, "ky": 10.0})
    assert values("ky", steps) == values("kp", steps)


def test_what_a_node_takes_at_its_start_is_not_ramped():
    node = {"command": "python3 servo.py", "at_start": ["kp"]}
    study = make({"kp": DOUBLE, "kd": DOUBLE}, node=node)
    steps = way(study, {"kp": 1.0, "kd": 1.0}, {"kp": 5.0, "kd": 5.0})
    assert steps == [{"kd": 2.0}, {"kd": 3.0}, {"kd": 4.0}]


LINEAR_PAIR = {"ki": DOUBLE, "kp": DOUBLE}
LOG_PAIR = {"ki": LOG_DOUBLE, "kp": LOG_DOUBLE}
MIXED = {"ki": DOUBLE, "kp": LOG_DOUBLE}
INTEGER = {"kp": DOUBLE, "n": DOUBLE | {"type": "integer", "bounds": [1, 9], "default": 1}}


@pytest.mark.parametrize(
    ("parameters", "rules"),
    [
        (LINEAR_PAIR, {"order": [["ki", "kp"]]}),
        (LOG_PAIR, {"order": [["ki", "kp"]]}),
        (LINEAR_PAIR, {"where": ["ki <= kp / 2 + 1"]}),
        # Of logarithms it is linear, too.
        (LOG_PAIR, {"where": ["ki * kp <= 3"]}),
        (INTEGER, {"where": ["n <= 5", "kp < 4"]}),
    ],
)
def test_rules_that_hold_on_straight_lines_go_with_a_ramp(parameters, rules):
    make(parameters, **rules)


@pytest.mark.parametrize(
    ("parameters", "rules", "problem"),
    [
        # The mean of 1 and 9 exceeds their geometric mean.
        (MIXED, {"order": [["ki", "kp"]]}, r"\(expected 'ki' <= 'kp', found "),
        (LINEAR_PAIR, {"where": ["ki * kp <= 3"]}, r"\(breaks the condition 'ki \* kp <= 3': "),
        # Where the integer decreases, the double is there first.
        (INTEGER, {"where": ["kp * n <= 20"]}, r"\(breaks the condition 'kp \* n <= 20': "),
    ],
)
def test_rules_that_a_straight_line_may_break_are_refused_with_a_ramp(parameters, rules, problem):
    make(parameters, ramp=None, **rules)
    start = r"^run\.ramp: a straight line between two parameter sets leads through one that is not "
    with pytest.raises(StudyError, match=f"{start}permitted {problem}"):
        make(parameters, **rules)
