"""The Pareto front of the trials, and what other limits would cost."""

import itertools
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bo_tuner.figures.figure import Points
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.trade_off import pareto_front, trade_off
from bo_tuner.trials import CHECKS

numbers = st.integers(-3, 3).map(float)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12))
def test_the_front_is_what_no_other_point_dominates(points):
    cost, worst = np.array(points).T
    front = pareto_front(cost, worst)

    def dominated(k):
        no_worse = (cost <= cost[k]) & (worst <= worst[k])
        return bool(np.any(no_worse & ((cost < cost[k]) | (worst < worst[k]))))

    # Of equal points one stands for all.
    expected = {points[k] for k in range(len(points)) if not dominated(k)}
    assert {points[k] for k in front} == expected
    assert len(front) == len(expected)
    assert list(worst[front]) == sorted(worst[front])


def test_a_looser_limit_costs_nothing(analysis):
    section = trade_off(analysis)
    assert section is not None
    (table,) = section.tables
    found = [float(row[2].split()[0]) for row in table.rows if row[1] != "none"]
    assert found == sorted(found, reverse=True)
    # No two rows have the same trial.
    numbers = [row[1] for row in table.rows]
    assert len(set(numbers)) == len(numbers)


def test_limits_that_make_no_difference_beyond_the_noise_share_a_row(analysis):
    """Each trial has runs between 1 and 9, whatever its parameters are."""

    def noisy(trial):
        evaluations = [
            replace(e, outcome=replace(e.outcome, metrics={**e.outcome.metrics, "error": value}))
            if e.outcome.metrics
            else e
            for e, value in zip(
                trial.evaluations, itertools.cycle((1.0, 9.0 + 0.01 * trial.number))
            )
        ]
        return replace(trial, evaluations=tuple(evaluations))

    record = replace(
        analysis.record,
        summary=None,
        trials=tuple(map(noisy, analysis.record.trials)),
        evaluations=tuple(e for e in analysis.record.evaluations if e.stage not in CHECKS),
    )
    section = trade_off(Analysis(record))
    numbers = [row[1] for table in section.tables for row in table.rows]
    assert len([number for number in numbers if number != "none"]) <= 1


def limited(analysis, worst, noise, **limits):
    """The run with a limit of other kind, and with these worst cases."""
    study = analysis.study
    (constraint,) = study.worst_case_constraints
    constraints = {constraint.name: replace(constraint, **limits)}
    trials = tuple(
        replace(
            trial,
            worst_cases={
                name: replace(found, value=worst, noise=noise)
                for name, found in trial.worst_cases.items()
            },
        )
        for trial in analysis.record.trials
    )
    record = replace(
        analysis.record,
        study=replace(study, constraints=constraints),
        # Worst cases of trials that were checked are estimated anew.
        evaluations=tuple(e for e in analysis.record.evaluations if e.stage not in CHECKS),
        trials=trials,
    )
    return Analysis(replace(record, summary=None))


def test_a_limit_on_single_runs_is_kept_by_those_whose_verdict_says_so(analysis):
    """Their means of 0.98 are below the limit of 1, what one run in ten exceeds is above."""
    found = limited(analysis, 0.98, 0.05, probability=0.9)
    (table,) = trade_off(found).tables
    (none, some) = table.rows
    assert none[:2] == ["0.8 to 1", "none"]
    assert some[0] == "1.1 to 1.25"
    assert some[1] != "none"
    assert table.header[0] == "limit [N]"


def test_a_limit_of_zero_has_no_others_to_look_at(analysis):
    section = trade_off(limited(analysis, -0.1, 0.0, upper=0.0))
    assert section.tables == []


def test_limits_outside_the_range_of_the_metric_are_not_looked_at(analysis):
    """Of 0.8, 0.9, 1, 1.1 and 1.25 only those from 0.9 on and below 1.25 can be a limit."""
    study = analysis.study
    (constraint,) = study.worst_case_constraints
    peak = replace(study.metrics[constraint.metric], range=(0.85, 1.25))
    metrics = {**study.metrics, constraint.metric: peak}
    record = replace(analysis.record, study=replace(study, metrics=metrics))
    (table,) = trade_off(limited(Analysis(record), 0.98, 0.05, probability=0.9)).tables
    assert [row[0] for row in table.rows] == ["0.9 to 1", "1.1"]


def test_the_default_is_where_the_verdict_has_it(analysis):
    (figure,) = trade_off(analysis).figures
    (default,) = [
        element
        for element in figure.panels[0].elements
        if isinstance(element, Points) and element.name == "default"
    ]
    found = {q.label: q.default for q in analysis.verdict.quantities}
    assert list(default.x) == [found["largest peak"]]
    assert list(default.y) == [found["mean error"]]
