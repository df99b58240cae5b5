"""The headline of a result: what is gained, from the facts."""

from dataclasses import replace

import pytest

from bo_tuner.evidence.differences import Change, Difference
from bo_tuner.evidence.estimates import Estimate, Source
from bo_tuner.evidence.facts import Basis, Progress, Said
from bo_tuner.evidence.gains import gains
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.reasons import Assumption
from bo_tuner.evidence.verdict import State, Status, Verdict
from bo_tuner.evidence.words.verdict import headline, page_title
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import Standing

ESTIMATE = Estimate(10.0, 0.1, 25, Source.VALIDATION, adjusted=False, low=9.8, high=10.2)
LIMIT = Constraint(name="peak", kind="worst_case", metric="peak", upper=1.0)
OPEN = LimitVerdict(
    constraint=LIMIT, title="peak", unit="mm", standing=Standing.OPEN, runs=25, violations=0
)


def numbers(mean, *, sign=1.0, default_over=0):
    """The objective and a limit: of the former the difference from 10, which is exact to 0.1."""
    difference = Difference(mean, mean - 0.1, mean + 0.1, 25)
    base = {"unit": "mm"}
    objective = Quantity(
        label="mean error", metric="error", title="error", default=10.0,
        tuned=10.0 + mean, difference=difference,
        change=difference.change(sign), objective=True, **base,
    )  # fmt: skip
    limited = Quantity(
        label="largest peak", metric="peak", title="peak", default=0.0, tuned=0.0, difference=None,
        change=Change.UNKNOWN, limit=1.0, constraint="peak", limit_verdict=OPEN,
        default_limit_verdict=replace(OPEN, violations=default_over), **base,
    )  # fmt: skip
    return objective, limited


def verdict(mean, state=State.VALIDATED, **changes):
    default_over = changes.pop("default_over", 0)
    fields = {
        "state": state, "trial": 3, "basis": Basis(25),
        "quantities": numbers(mean, default_over=default_over),
        "default_reasons": (Said("peak"),) if default_over else (),
    }  # fmt: skip
    return Verdict(**(fields | changes))


def test_what_has_changed_is_told_by_its_percentage():
    found = verdict(-2.5, default_over=2)
    assert [q.title for q in gains(found)] == ["error"]
    assert headline(found) == "Error -25 %; no limit broken in 25 test runs; not certified yet"
    assert headline(verdict(0.05, default_over=2)).startswith("Error as before; ")


def test_what_got_worse_is_told_and_has_the_mark_of_a_warning():
    found = verdict(5.6, default_over=2)
    assert headline(found).startswith("Error +56 % (worse); ")
    shown = replace(found, state=State.CERTIFIED)
    assert found.status is shown.status is Status.WARNING
    assert replace(shown, quantities=numbers(-5.6)).status is Status.GOOD


def test_a_metric_is_told_once_by_its_mean_and_what_is_limited_comes_first():
    def of(metric, percent, *, limited=False, **more):
        default, tuned = 10.0, 10.0 + 0.1 * percent
        change = Change.LOWER if percent < 0.0 else Change.HIGHER
        more = {"constraint": metric, "change": Change.UNKNOWN} if limited else {"change": change}
        estimates = None if limited else (ESTIMATE, ESTIMATE)
        difference = Difference(tuned - default, -9.0, -0.1, 25)
        return Quantity(
            label=f"mean {metric}", metric=metric, title=metric, unit="", default=default,
            tuned=tuned, difference=difference, estimates=estimates, **more,
        )  # fmt: skip

    found = replace(
        verdict(0.0), quantities=(
            numbers(0.0)[0], of("heat", -10.0, limited=True), of("heat", -10.0),
            of("effort", -91.0), of("noise", -20.0), of("wear", -30.0),
        ),
    )  # fmt: skip
    titles = [(q.title, q.estimates is None) for q in gains(found)]
    # Three, the largest of those without a limit among them, and the objective.
    assert titles == [("heat", False), ("effort", False), ("wear", False), ("error", True)]


@pytest.mark.parametrize(
    ("changes", "beginning"),
    [
        ({"mean": 5.6}, "The default has the better objective: error +56 % (worse); "),
        ({"mean": 0.0, "is_default": True}, "Keep the default, no better set was found; "),
        ({"mean": 0.05}, "No gain over the default beyond chance; "),
    ],
)
def test_the_default_is_kept_where_nothing_is_gained(changes, beginning):
    assert headline(verdict(**changes)).startswith(beginning)


def test_a_certificate():
    proven = replace(OPEN, standing=Standing.SHOWN, certified=True)
    objective, limited = numbers(-2.5)
    found = verdict(-2.5, State.CERTIFIED)
    found = replace(found, quantities=(objective, replace(limited, limit_verdict=proven)))
    assert headline(found) == "PASS: error -25 %; the limit proven"
    assert page_title(found) == "Error -25\N{NO-BREAK SPACE}%; the limit proven"
    conditional = replace(proven, condition=Assumption("peak"))
    found = replace(found, quantities=(objective, replace(limited, limit_verdict=conditional)))
    assert headline(found).endswith("; the limit shown with an assumption")


def test_a_refused_one_names_the_limits():
    refused = replace(OPEN, standing=Standing.VIOLATED, certified=True)
    objective, limited = numbers(-2.5)
    quantities = (objective, replace(limited, limit_verdict=refused))
    found = replace(verdict(-2.5, State.REFUSED), quantities=quantities)
    assert headline(found) == "FAIL: not proven to stay within the limit of peak"


def test_before_there_is_a_result():
    found = Verdict(state=State.OPEN, trial=None, basis=Progress(2, 5, spent=False))
    assert headline(found) == page_title(found) == "No result yet: 2 of 5 trials"
