"""The line that says what to set."""

from dataclasses import replace

import pytest

from bo_tuner.evidence.at_bounds import at_bounds
from bo_tuner.evidence.differences import Difference
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.verdict import Quantity, State, Status, Verdict
from bo_tuner.evidence.what_to_set import what_to_set
from bo_tuner.study.limits import Standing

OPEN = LimitVerdict(Standing.OPEN, 25, 0, None, "", "", "")


def numbers(mean, *, sign=1.0, default_over=0):
    """The objective and a limit: of the former the difference from 10, which is exact to 0.1."""
    difference = Difference(mean, mean - 0.1, mean + 0.1, 25)
    base = {"unit": "mm", "remark": "", "bound": float("nan")}
    objective = Quantity(
        label="mean error", metric="error", title="error", default=10.0,
        tuned=10.0 + mean, difference=difference,
        change=difference.change(sign), limit=float("nan"), objective=True, **base,
    )  # fmt: skip
    limited = Quantity(
        label="largest peak", metric="peak", title="peak", default=0.0, tuned=0.0, difference=None,
        change=difference.change(0.0), limit=1.0, constraint="peak", limit_verdict=OPEN,
        default_limit_verdict=replace(OPEN, violations=default_over), **base,
    )  # fmt: skip
    return objective, limited


def verdict(mean, state=State.VALIDATED, **changes):
    default_over = changes.pop("default_over", 0)
    fields = {
        "state": state, "trial": 3, "evidence": "25 draws",
        "quantities": numbers(mean, default_over=default_over),
        "default_reasons": ("peak",) if default_over else (),
    }  # fmt: skip
    return Verdict(**(fields | changes))


@pytest.fixture
def told(make_study):
    return lambda found: what_to_set(make_study(), found, {"gain": 0.25})


def test_a_result_that_keeps_its_limits(told):
    assert told(verdict(-2.5, default_over=2)) == (
        "Set gain 0.25: no limit broken in 25 test runs (default: 2), error 25 % lower, not "
        "certified yet"
    )
    assert ", error unchanged, " in told(verdict(0.05, default_over=2))


def test_what_got_worse_is_in_the_line_and_has_the_mark_of_a_warning(told):
    found = verdict(5.6, default_over=2)
    assert ", error 56 % higher (worse), " in told(found)
    shown = replace(found, state=State.CERTIFIED)
    assert found.status is shown.status is Status.WARNING
    assert replace(shown, quantities=numbers(-5.6)).status is Status.GOOD


def test_a_default_that_nothing_speaks_against_is_kept_if_it_is_better(told):
    assert told(verdict(5.6)).startswith(
        "Keep the default, which has the better objective. gain 0.25: no limit broken"
    )


def test_the_default_itself_is_kept(told):
    assert told(verdict(0.0, is_default=True)).startswith("Keep the default: no limit broken")


def test_a_certificate(told):
    assert told(verdict(-2.5, State.CERTIFIED)) == (
        "Set gain 0.25: proven to stay within all limits, error 25 % lower, certified (PASS)"
    )
    refused = told(verdict(-2.5, State.REFUSED, reasons=("peak",)))
    assert refused.startswith("Do not set gain 0.25. FAIL: ")


def test_nothing_is_to_be_set_where_nothing_was_found(told):
    infeasible = verdict(-2.5, State.INFEASIBLE, reasons=("peak",), default_over=2)
    assert told(infeasible) == "No feasible parameter set was found: do not set gain 0.25"
    assert told(replace(infeasible, default_reasons=())).startswith("Keep the default. ")


def test_a_result_at_a_bound_says_so(told, make_study):
    bounds = at_bounds(make_study(), {"gain": 1.0})
    assert told(verdict(-2.5, at_bounds=bounds)).endswith(", gain at its upper bound")


def test_before_there_is_a_result(make_study):
    found = Verdict(state=State.OPEN, trial=None, evidence="2 of 5 trials")
    assert what_to_set(make_study(), found, {}) == "No result yet: 2 of 5 trials"
    line = what_to_set(make_study(), found, {"gain": 0.25})
    assert line == "No result yet: 2 of 5 trials. Best so far: gain 0.25"


def test_many_values_stand_below_the_line(make_study):
    item = {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}
    study = make_study(parameters=dict.fromkeys("abcde", item))
    line = what_to_set(study, verdict(-2.5), dict.fromkeys("abcde", 0.1))
    assert line.startswith("Set the 5 values below: ")
