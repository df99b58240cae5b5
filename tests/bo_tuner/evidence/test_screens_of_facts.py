"""What screens say, from facts that are written by hand: read it when it changes."""

from pathlib import Path

import pytest
from terminals import console

from bo_tuner.evidence.at_bounds import AtBound
from bo_tuner.evidence.differences import Change, Difference
from bo_tuner.evidence.estimates import Estimate, Source
from bo_tuner.evidence.facts import (
    AgainstLimit,
    Basis,
    BetterSet,
    CertificateBegun,
    Doubt,
    Drift,
    PassedOver,
    TrialsEnded,
    TwoKinds,
)
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import DrawsOf, OnRecord, Quantity
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.terminal import print_verdict
from bo_tuner.report.sections.limit_rows import bar, rows
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import Standing

SCREEN = Path(__file__).with_suffix(".txt")


def estimate(value):
    return Estimate(value, 0.01, 25, Source.VALIDATION, True, value - 0.02, value + 0.02)


def mean(metric, default, tuned, change, *, objective=False, draws=None):
    found = Difference(tuned - default, tuned - default - 0.1, tuned - default + 0.1, 25)
    return Quantity(
        label=f"mean {metric}", metric=metric, title=metric, unit="m", default=default,
        tuned=tuned, estimates=(estimate(default), estimate(tuned)), difference=found,
        change=change, objective=objective, draws=draws,
    )  # fmt: skip


def limit(violations, standing=Standing.OPEN, **more):
    constraint = Constraint(
        name="peak", kind="chance", metric="peak", upper=2.0, probability=0.9
    )  # fmt: skip
    return LimitVerdict(
        constraint=constraint, title="peak", unit="N", standing=standing, runs=25,
        violations=violations, confidence=0.95, **more,
    )  # fmt: skip


@pytest.fixture
def verdict():
    over = limit(5, Standing.VIOLATED, refuted=True)
    return Verdict(
        state=State.VALIDATED,
        trial=7,
        basis=Basis(25),
        default_reasons=(Doubt("By the model it is 3 % likely within limits"), AgainstLimit(over)),
        quantities=(
            mean("error", 1.0, 0.98, Change.NONE, objective=True),
            Quantity(
                label="largest peak", metric="peak", title="peak", unit="N", default=2.5,
                tuned=1.9, difference=None, change=Change.UNKNOWN, limit=2.0, constraint="peak",
                limit_verdict=limit(1), default_limit_verdict=over,
                on_record=OnRecord(40, 2.03), draws=DrawsOf(24, 25),
            ),
            mean("peak", 1.5, 0.75, Change.BETTER, draws=DrawsOf(24, 25, 24)),
            mean("effort", 10.0, 1.0, Change.LOWER),
        ),
        remarks=(
            TrialsEnded(12, 30, time_up=True),
            PassedOver("error", "m", (BetterSet(4, 0.9, 0.8, False),), compromises=False),
            Drift("peak", "tuned", 25, False, 0.61, 0.002),
            TwoKinds("peak", "peak", "default", (5, 2.4), (20, 1.3), needs_range=True),
            CertificateBegun(59),
        ),
        at_bounds=(AtBound("gain", "gain", "", "upper", 1.0, (0.0, 1.0), (0.0, 2.0)),),
    )  # fmt: skip


def test_the_end_of_a_run_in_the_terminal(verdict, make_study):
    out = console(160)
    print_verdict(out, make_study(), verdict, {"gain": 1.0})
    lines = [line.rstrip() for line in out.file.getvalue().splitlines()]
    assert lines == SCREEN.read_text(encoding="utf-8").splitlines()


def test_the_table_of_the_first_screen_of_a_report(verdict):
    told = [(row.title, row.detail, row.default, row.tuned, row.change) for row in rows(verdict)]
    assert told == [
        ("error [m]", "mean, objective", "1", "0.98", "as before (±0.1)"),
        ("peak [N]", "largest · 90 % of runs", "2.5", "1.9", "mean -50 %"),
        ("effort [m]", "mean", "10", "1", "-90 %"),
    ]
    (limited,) = [row for row in rows(verdict) if row.limit]
    assert (limited.limit, limited.shown, limited.runs) == (
        "≤ 2", "not proven", "1 of 25 runs over, 10 % may",
    )  # fmt: skip
    assert limited.bar == bar(2.5, 1.9, 2.0)


def test_a_bar_has_its_limit_at_one_place_unless_a_value_is_far_beyond():
    near, far = bar(1.0, 0.5, 2.0), bar(8.0, 3.0, 2.0)
    assert (near.tuned / near.limit, near.default / near.limit) == pytest.approx((0.25, 0.5))
    assert near.limit == pytest.approx(0.8)
    # Twice the limit at most: what is farther is at the end.
    assert (far.default, far.limit, far.tuned) == pytest.approx((1.0, 0.5, 0.75))
    assert bar(1.0, 0.5, 0.0) is bar(1.0, -0.5, 2.0) is None
