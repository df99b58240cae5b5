"""The page of a run in progress, from trials and a question that are made by hand."""

import math
import re
from dataclasses import replace

import pytest

from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.figures.figure import Limit, Line, Points
from bo_tuner.report.live import (
    LATEST,
    bar,
    latest_trials,
    limit_panels,
    objective_panel,
    step_in_words,
)
from bo_tuner.report.page import live_parts, question_html
from bo_tuner.tuning.question import Asked, Change, Expected


@pytest.fixture(scope="module")
def study(make_study):
    """A study with a limit of 1 on the peak."""
    return make_study()


@pytest.fixture(scope="module")
def trials(make_trial):
    """Over the limit, within it, failed, and within it again."""
    return [
        make_trial(0, {"gain": 0.1}, [2.2, 2.0], worst=1.1),
        make_trial(1, {"gain": 0.2}, [2.0], worst=0.5),
        make_trial(2, {"gain": 0.3}),
        make_trial(3, {"gain": 0.4}, [1.5], worst=0.75),
    ]


def points(panel):
    """Places of the marks by their names."""
    found = {}
    for element in panel.elements:
        if isinstance(element, Points):
            found[element.name] = list(zip(element.x, element.y, strict=True))
    return found


def test_the_objective_by_outcome(study, trials):
    panel = objective_panel(study, trials, {})
    shown = points(panel)
    assert shown[TrialOutcome.WITHIN] == [(1.0, 2.0), (3.0, 1.5)]
    assert shown[TrialOutcome.VIOLATES] == [(0.0, pytest.approx(2.1))]
    # At the edge, since it has no value.
    ((x, edge),) = shown[TrialOutcome.FAILED]
    assert (x, edge > 2.1) == (2.0, True)
    filled = {e.name: e.filled for e in panel.elements if isinstance(e, Points)}
    assert filled[TrialOutcome.WITHIN]
    assert not filled[TrialOutcome.VIOLATES]


def test_the_line_is_the_best_within_limits_and_begins_with_the_first(study, trials):
    assert not [e for e in objective_panel(study, trials, {}).elements if isinstance(e, Line)]
    (line,) = [
        e
        for e in objective_panel(study, trials, {2: 1, 3: 1, 4: 3}).elements
        if isinstance(e, Line)
    ]
    assert line.step
    assert list(zip(line.x, line.y, strict=True)) == [(1, 2.0), (2, 2.0), (3, 1.5), (3.5, 1.5)]


def test_the_line_has_a_gap_where_the_run_takes_none_for_within_limits(study, trials):
    best = {1: None, 2: 1, 3: None, 4: 3}
    (line,) = [e for e in objective_panel(study, trials, best).elements if isinstance(e, Line)]
    assert line.y == pytest.approx([math.nan, 2.0, math.nan, 1.5, 1.5], nan_ok=True)
    assert live_parts(study, trials[:3], {1: None, 2: 1, 3: None})["values"] == ""


def test_limits_stand_in_percent_of_themselves(study, trials):
    (panel,) = limit_panels(study, trials)
    assert [e.value for e in panel.elements if isinstance(e, Limit)] == [100.0]
    shown = points(panel)
    assert shown[TrialOutcome.WITHIN] == [(1.0, 50.0), (3.0, 75.0)]
    assert shown[TrialOutcome.VIOLATES] == [(0.0, pytest.approx(110.0))]
    assert panel.title.endswith("limit ≤ 1")


def test_the_latest_trials_come_first(study, trials, make_trial):
    many = [*trials, *(make_trial(k, {"gain": 0.5}, [1.0]) for k in range(4, 11))]
    table = latest_trials(study, many)
    assert [row[0] for row in table.rows] == [str(k) for k in range(10, 10 - LATEST, -1)]
    table = latest_trials(study, trials)
    by_name = [dict(zip(table.header, row, strict=True)) for row in table.rows]
    last, failed, _, over = by_name
    assert (last["gain"], last["test runs"], last["outcome"]) == ("0.4", "1", "✓ within limits")
    assert last["peak, % of the limit"] == "75"
    assert failed["outcome"].startswith("✗ failed")
    # As in the terminal.
    assert over["outcome"].startswith("! over the limit")


def test_a_page_before_the_first_trial(study):
    html = live_parts(study, [], {})
    assert html.keys() == {"objective", "limits", "trials", "values"}
    assert "0 trials" in html["trials"]
    assert html["values"] == ""


def test_the_values_of_the_best(study, trials):
    html = live_parts(study, trials, {2: 1, 4: 3})["values"]
    assert "Values of trial 3, the best within limits" in html
    assert re.findall(r'<td class="number">([^<]+)</td>', html) == ["0.4", "0.5"]


UPPER = Expected("peak", "N", 0.6, 0.4, 0.8, limit=1.0, words="worst peak")


class TestExpected:
    def test_a_bar_shows_the_band_and_the_limit_in_proportion(self):
        row = bar(UPPER)
        assert (row.title, row.expected, row.band) == ("peak [N]", "0.6", "0.4 to 0.8")
        assert row.limit_in_words == "≤ 1"
        ratios = [each / row.limit for each in (row.low, row.value, row.high)]
        assert ratios == pytest.approx([0.4, 0.6, 0.8], abs=0.002)
        assert row.limit < 100.0
        assert not row.is_over

    @pytest.mark.parametrize(
        ("value", "limit", "is_upper", "is_over"),
        [(1.1, 1.0, True, True), (1.1, 1.0, False, False), (-3.0, -2.0, False, True)],
    )
    def test_beyond_a_limit(self, value, limit, is_upper, is_over):
        row = bar(
            replace(
                UPPER, value=value, low=value - 1, high=value + 1, limit=limit, is_upper=is_upper
            )
        )
        assert row.is_over is is_over
        assert row.limit_in_words == f"{'≤' if is_upper else '≥'} {limit:g}"
        places = [row.low, row.value, row.high, row.limit]
        assert all(0.0 <= place <= 100.0 for place in places)
        assert (row.value > row.limit) == (value > limit)

    def test_without_a_limit_there_is_no_bar(self):
        row = bar(Expected("error", "", math.pi, 3.0, 3.5))
        assert (row.expected, row.limit) == ("3.142", None)


def test_steps_in_words():
    words = [step_in_words(Change("gain", *each, 0.0)) for each in ((1.0, 1.0), (1.0, 0.5), (3, 4))]
    assert words == ["same", "-0.5", "+1"]
    assert step_in_words(Change("mode", "fast", "slow", "fast")) == "other"


def test_a_question_says_what_why_and_what_is_expected():
    change = Change("gain <b>", 1.0, 0.5, 2.0)
    html = question_html(Asked(4, "repetition", "trial before", (change,), (UPPER,), ("near",)))
    for text in (
        "May trial 4 be tried?",
        "The same again, to learn its noise.",
        "gain &lt;b&gt;",
        "worst peak, within its limit",
        "≤ 1",
        "near",
    ):
        assert text in html, text
