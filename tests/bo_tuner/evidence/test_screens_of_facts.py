"""What screens say, from facts that are written by hand: read it when it changes."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from terminals import console

from bo_tuner.evidence.at_bounds import AtBound
from bo_tuner.evidence.certificate.findings import ConstraintVerdict, WorstContext
from bo_tuner.evidence.certificate.risk import Mean
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
    Seen,
    TrialsEnded,
    TwoKinds,
)
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import DrawsOf, OnRecord, Quantity
from bo_tuner.evidence.reasons import Assumption, Reason, Why
from bo_tuner.evidence.trial_row import TrialLimit, TrialOutcome, TrialRow
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.reasons import assumption, proven, reason
from bo_tuner.evidence.words.terminal import print_verdict
from bo_tuner.evidence.words.trials import ending, outcome, sign
from bo_tuner.report.sections.limit_rows import bar, rows
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import Standing
from bo_tuner.study.measured import SeenRange

SCREEN = Path(__file__).with_suffix(".txt")
WHY = Path(__file__).with_name("test_why_a_limit_is_not_shown.txt")


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
            Seen("wind", "m/s", SeenRange(0.25, 3.125, 1.5)),
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


IN_SOME = WorstContext(
    context={"load": 1.5}, mean=Mean(1.25, 0.1, upper=inf, lower=1.0), extreme=1.6, evaluations=30,
    beyond=4, failures=1, violation_bound=0.31, shown=False, earlier=12, together=1.75,
)  # fmt: skip
IN_ANOTHER = replace(IN_SOME, context={"load": 2.0}, mean=Mean(1.0, 0.1, upper=2.5, lower=0.5))
REASONS = [
    Reason(Why.SHARE, needed=59), Reason(Why.MEAN, bound=2.125), Reason(Why.MEAN),
    Reason(Why.TWO_KINDS), Reason(Why.WITHOUT_NOISE),
    Reason(Why.EARLIER, earlier=20, together=0.125), Reason(Why.DRAWS), Reason(Why.NOT_RUN),
    Reason(Why.NOT_RUN, not_run=2), Reason(Why.FAILED), Reason(Why.EARLIER_IN_CONTEXT),
    Reason(Why.SHARE_IN_CONTEXT), Reason(Why.MEAN_IN_CONTEXT),
    Reason(Why.MEAN_IN_CONTEXT, place=1), Reason(Why.REFUTED_IN_CONTEXT),
    Reason(Why.TWO_KINDS_IN_CONTEXT, place=1),
]  # fmt: skip


def test_why_a_limit_is_not_shown():
    found = ConstraintVerdict(
        name="peak", kind="chance", metric="peak", unit="N", limit=2.0, side="upper", allowed=0.1,
        draws=40, violations=1, failures=1, violation_bound=0.15, extreme=2.5, tail=2.25,
        worst=(IN_SOME, IN_ANOTHER), assumption=None, refuted=False, passed=False,
        reason=REASONS[0],
    )  # fmt: skip
    told = [reason(replace(found, reason=each)) for each in REASONS]
    passed = replace(found, passed=True, reason=Reason(Why.MEAN, bound=1.875))
    on_mean = replace(found, allowed=1.0, reason=REASONS[5])
    told += [reason(passed), reason(replace(passed, side="lower")), reason(on_mean)]
    for assumed in (None, Assumption("peak"), Assumption("peak", 3)):
        told.append(proven(replace(passed, assumption=assumed)))
    told += [proven(found), assumption(Assumption("peak")), assumption(Assumption("peak", 3))]
    assert told == WHY.read_text(encoding="utf-8").splitlines()


def row(outcome, *limits, reason=""):
    return TrialRow(3, (0.5,), (1.25,), limits, outcome, reason, 7, {"load": 1.8820001}, 924)


def test_the_outcome_of_a_trial():
    peak = Constraint(name="peak", kind="worst_case", metric="peak", upper=2.0)
    force = Constraint(name="force", kind="worst_case", metric="force", lower=10.0)
    over = TrialLimit(peak, "worst peak", 2.004, TrialOutcome.VIOLATES)
    close = TrialLimit(force, "force", 10.25, TrialOutcome.UNCERTAIN)
    rows = [
        row(TrialOutcome.WITHIN), row(TrialOutcome.UNCERTAIN, close),
        row(TrialOutcome.VIOLATES, over, close),
        row(TrialOutcome.CUT_SHORT, reason="peak is 2.5 at least"),
        row(TrialOutcome.FAILED, reason="axis: stalled"),
    ]  # fmt: skip
    assert [f"{sign(each.outcome)} {outcome(each)}" for each in rows] == [
        "✓ within limits",
        "~ margin too small (force 10.25 < 10)",
        "! over the limit (worst peak 2.004 > 2); margin too small (force 10.25 < 10)",
        "✗ cut short",
        "✗ failed",
    ]
    assert [ending(each) for each in rows[3:]] == [
        "peak is 2.5 at least (context load 1.882; seed 924)",
        "FAILED: axis: stalled (context load 1.882; seed 924)",
    ]
