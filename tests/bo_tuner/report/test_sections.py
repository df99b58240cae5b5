"""Sections: what they say follows from the record, by other means than theirs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bo_tuner.evidence.trial_row import TrialOutcome
from bo_tuner.figures.figure import Contour, Heatmap, Limit, Line, Points
from bo_tuner.report import content
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.grid import parameter_grid, permitted
from bo_tuner.report.sections.appendix import all_trials
from bo_tuner.report.sections.contexts import contexts
from bo_tuner.report.sections.contours import contours
from bo_tuner.report.sections.convergence import MOST_INCUMBENTS, _counts, convergence
from bo_tuner.report.sections.effects import effects
from bo_tuner.report.sections.failures import failures
from bo_tuner.report.sections.slices import slices
from bo_tuner.report.sections.surrogates import surrogates
from bo_tuner.report.sections.timing import timing
from bo_tuner.report.sections.tolerance import tolerance
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import CHECKS, Stage
from bo_tuner.tuning.recorded_method import recorded_method


def named(panel, name, kind):
    found = [e for e in panel.elements if isinstance(e, kind) and e.name == name]
    return found[0] if found else None


def test_the_best_so_far_is_the_one_that_rank_names(analysis):
    figure, _ = convergence(analysis).figures
    (panel,) = figure.panels
    line = named(panel, "best so far", Line)
    trials = analysis.record.trials
    expected = {}
    for n in range(1, len(trials) + 1):
        ranked = recorded_method(analysis.record).ranking.rank(analysis.study, trials[:n])
        if ranked:
            first = ranked[0]
            expected[n - 1.0] = first.objective if first.believed_feasible else math.nan
    np.testing.assert_array_equal(line.x, list(expected))
    np.testing.assert_array_equal(line.y, list(expected.values()))


def test_the_table_has_the_worst_cases_that_were_recorded(analysis):
    """As the lines of the run had them, unless the trial was run again after it."""
    table = all_trials(analysis).tables[0]
    place = next(k for k, title in enumerate(table.header) if title.startswith("worst peak"))
    again = {e.trial for e in analysis.record.evaluations if e.stage in CHECKS}
    recorded = {t.number: t.worst_cases for t in analysis.record.trials if t.number not in again}
    assert sum(map(bool, recorded.values())) > 1
    for row in table.rows:
        worst = recorded.get(int(row[0]))
        if worst is not None:
            assert row[place] == content.number(worst["peak"].value if worst else None)


@pytest.mark.parametrize("total", [1, 2, 39, 41, 99, 101, 1000, 2357])
def test_incumbents_of_a_long_run_are_few_and_known_when_a_trial_has_been_added(total):
    counts = _counts(total)
    assert counts == sorted(set(counts))
    assert (counts[0], counts[-1]) == (1, total)
    assert len(counts) <= MOST_INCUMBENTS + 1
    assert set(counts[:-1]) < set(_counts(total + 1))


def far_off(analysis, value, index=0):
    """The run with values of the objective far off in one of its trials."""
    trials = list(analysis.record.trials)
    changed = [
        replace(e, outcome=replace(e.outcome, metrics={**e.outcome.metrics, "error": value}))
        for e in trials[index].evaluations
    ]
    trials[index] = replace(trials[index], evaluations=tuple(changed))
    return Analysis(replace(analysis.record, trials=tuple(trials)))


def test_a_far_value_is_off_the_scale_above_all_that_is_on_it(analysis):
    """The line of the default included, which no trial need be near to."""
    found = far_off(analysis, 123.4)
    default = 6.5
    verdict = found.verdict
    quantities = [replace(q, default=default) if q.objective else q for q in verdict.quantities]
    vars(found)["verdict"] = replace(verdict, quantities=tuple(quantities))
    figure, _ = convergence(found).figures
    (panel,) = figure.panels
    mark = named(panel, "off the scale, to 123.4", Points)
    assert list(mark.x) == [0.0]
    assert "off the scale: 123.4" in mark.hover[0]
    others = [
        y
        for e in panel.elements
        if isinstance(e, (Points, Line)) and e is not mark
        for y in e.y
        if not math.isnan(y)
    ]
    assert named(panel, "default", Limit).value == default
    assert mark.y[0] >= max([*others, default])
    assert 0.0 not in [
        x
        for e in panel.elements
        if isinstance(e, Points) and e is not mark
        for x, y in zip(e.x, e.y, strict=True)
        if not math.isnan(y)
    ]


def test_the_worst_case_of_a_trial_is_what_its_limit_is_held_against(analysis):
    """Of single runs a quantile: the mean plus so many standard deviations."""
    constraint = replace(analysis.study.constraints["peak"], probability=0.9)
    study = replace(analysis.study, constraints={"peak": constraint})
    noisy = tuple(
        replace(t, worst_cases={n: replace(w, noise=0.01) for n, w in t.worst_cases.items()})
        for t in analysis.record.trials
    )
    evaluations = tuple(e for e in analysis.record.evaluations if e.stage not in CHECKS)
    record = replace(analysis.record, study=study, trials=noisy, evaluations=evaluations)
    _, figure = convergence(Analysis(replace(record, summary=None))).figures
    (panel,) = figure.panels
    assert panel.y.label == "worst 0.9 quantile of peak"
    drawn = {
        int(x): y
        for e in panel.elements
        if isinstance(e, Points) and not e.name.startswith("off the scale")
        for x, y in zip(e.x, e.y, strict=True)
        if not math.isnan(y)
    }
    complete = [t for t in noisy if t.worst_cases and t.number in drawn]
    assert len(complete) > 2
    for trial in complete:
        # 1.2816 standard deviations are between the mean and nine tenths of a normal variable.
        expected = trial.worst_cases["peak"].value + 1.2816 * 0.01
        assert drawn[trial.number] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("probability", [None, 0.9])
def test_the_caption_says_what_the_limit_is_held_against(analysis, probability):
    constraint = replace(analysis.study.constraints["peak"], probability=probability)
    study = replace(analysis.study, constraints={"peak": constraint})
    _, figure = convergence(Analysis(replace(analysis.record, study=study))).figures
    assert ("with a probability of 0.9" in figure.caption) == (probability is not None)


def test_every_trial_is_a_point_of_its_kind(analysis):
    figure, _ = convergence(analysis).figures
    places = {}
    for kind in (
        TrialOutcome.WITHIN,
        TrialOutcome.VIOLATES,
        TrialOutcome.OUTLIER,
        TrialOutcome.FAILED,
    ):
        points = named(figure.panels[0], kind, Points)
        places |= dict.fromkeys([] if points is None else list(points.x), kind)
    for number, trial in enumerate(analysis.record.trials):
        gain = trial.parameters["gain"]
        if gain > 0.6:
            assert places[number] == TrialOutcome.FAILED
        elif number in analysis.models.outliers:
            assert places[number] == TrialOutcome.OUTLIER
        else:
            # The worst load is 2, so the peak is 4 gain at most.
            worst = trial.worst_cases["peak"].value
            assert places[number] == (TrialOutcome.VIOLATES if worst > 1.0 else TrialOutcome.WITHIN)
    assert len(places) == len(analysis.record.trials)


def test_the_report_calls_a_trial_what_the_console_calls_it(analysis):
    """Also where the mean in the worst context keeps a limit that single runs may not keep."""
    constraint = replace(analysis.study.constraints["peak"], probability=0.9)
    study = replace(analysis.study, constraints={"peak": constraint})
    noisy = [
        replace(t, worst_cases={n: replace(w, noise=10.0) for n, w in t.worst_cases.items()})
        for t in analysis.record.trials
    ]
    found = Analysis(replace(analysis.record, study=study, trials=tuple(noisy)))
    words = {"within limits": "within limits", "may violate peak": "margin too small"}
    words |= {"violates peak": "over the limit", "failed": "failed"}
    named = [(found.outcome(t), words[outcome_in_words(study, t)]) for t in noisy]
    assert all(outcome in (TrialOutcome.OUTLIER, word) for outcome, word in named)
    assert TrialOutcome.UNCERTAIN in {outcome for outcome, _ in named}


def test_failed_trials_are_above_all_others(analysis):
    figure, _ = convergence(analysis).figures
    failed = named(figure.panels[0], TrialOutcome.FAILED, Points)
    others = [
        value
        for kind in (TrialOutcome.WITHIN, TrialOutcome.VIOLATES)
        if (points := named(figure.panels[0], kind, Points)) is not None
        for value in points.y
    ]
    assert min(failed.y) >= max(others)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_with_an_objective_to_maximize_they_are_below_all_others(analysis, scale):
    """And what is far below the others is at the bottom, too."""
    objective = replace(analysis.study.objective, direction="maximize", scale=scale)
    study = replace(analysis.study, objective=objective)
    first, *others = analysis.record.trials
    far = [
        replace(e, outcome=replace(e.outcome, metrics={**e.outcome.metrics, "error": 1e-9}))
        for e in first.evaluations
    ]
    trials = (replace(first, evaluations=tuple(far)), *others)
    record = replace(analysis.record, study=study, trials=trials)
    figure, *_ = convergence(Analysis(record)).figures
    panel = figure.panels[0]
    failed = named(panel, TrialOutcome.FAILED, Points)
    seen = [e for e in panel.elements if isinstance(e, Points)]
    shown = [y for element in seen for y in element.y if not math.isnan(y)]
    assert max(failed.y) == min(failed.y) == min(shown)
    assert min(shown) > 1e-9 or scale == "linear"
    assert "At the bottom" in figure.caption


def test_the_slice_is_the_surrogate(analysis):
    figure = slices(analysis, analysis.answer)
    objective, peak = figure.panels
    line = named(objective, "predicted mean", Line)
    space = analysis.study.search_space()
    # Trials with a gain above 0.6 failed, so the models say nothing of a gain of 1.
    dotted = named(objective, "not in the models", Line)
    assert math.isnan(line.y[80])
    assert math.isnan(dotted.y[0])
    for k, shown in ((0, line), (17, line), (80, dotted)):
        x = space.to_cube({"gain": float(line.x[k])})[None]
        assert shown.y[k] == pytest.approx(float(analysis.models.objective.predict(x)[0][0]))
    tuned = named(objective, "tuned", Limit)
    assert tuned.value == analysis.answer.parameters["gain"]
    assert named(objective, "default", Limit).value == 0.5
    # A worst case has no margin for the noise of single evaluations.
    assert named(peak, "limit", Limit).value == 1.0


@pytest.mark.parametrize(
    ("algorithm", "kind", "label"),
    [
        ("boundary", "chance", "0.9 quantile of peak"),
        ("boundary", "worst_case", "worst 0.9 quantile of peak"),
        ("IV", "chance", "mean peak"),
        ("IV", "worst_case", "worst 0.9 quantile of peak"),
    ],
)
def test_a_slice_names_what_is_held_against_a_limit_on_single_runs(
    analysis, algorithm, kind, label
):
    """Either a quantile of them is modelled, or the limit is moved by a margin for their noise."""
    constraint = replace(analysis.study.constraints["peak"], kind=kind, probability=0.9)
    study = replace(analysis.study, constraints={"peak": constraint})
    found = Analysis(replace(analysis.record, study=study, algorithm=algorithm))
    figure = slices(found, analysis.answer)
    panel = figure.panels[1]
    assert panel.y.label == label
    moved = "quantile" not in label
    assert (named(panel, "limit", Limit).value < 1.0) is moved
    assert ("is drawn stricter" in figure.caption) is moved
    assert "quantile" in figure.caption


def two_parameters():
    from report_runs import NODE, axis_study

    return study_from_mapping(
        axis_study(
            parameters={
                "first": NODE | {"type": "integer", "bounds": [1, 6], "default": 2},
                "second": NODE | {"type": "integer", "bounds": [1, 9], "default": 3},
            },
            order=[["first", "second"]],
        )
    )


def test_a_grid_keeps_the_order_of_parameters():
    study = two_parameters()
    space = study.search_space()
    at = {"first": 2, "second": 3}
    first = parameter_grid(study, "first", at, 41)
    second = parameter_grid(study, "second", at, 41)
    assert first.values.tolist() == [1, 2, 3, 4, 5, 6]
    points = np.array([[a, b] for b in second.cube for a in first.cube])
    expected = [a <= b for b in second.values for a in first.values]
    assert permitted(study, points).tolist() == expected
    for a, x in zip(first.values, first.cube, strict=True):
        assert space.to_cube({"first": int(a), "second": 9})[0] == x


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_grid_has_the_values_of_a_parameter_with_a_step(scale):
    """Between them there is nothing to show: a line would have gaps, a contour be shaded."""
    from report_runs import NODE, axis_study

    stepped = NODE | {"type": "double", "bounds": [0.25, 1.3], "step": 0.25, "default": 0.5}
    even = NODE | {"type": "integer", "bounds": [2, 10], "step": 2, "default": 4}
    parameters = {"stepped": stepped | {"scale": scale}, "even": even}
    study = study_from_mapping(axis_study(parameters=parameters))
    at = {"stepped": 0.5, "even": 4}
    grids = [parameter_grid(study, name, at, 41) for name in parameters]
    assert grids[0].values.tolist() == [0.25, 0.5, 0.75, 1.0, 1.25]
    assert grids[1].values.tolist() == [2, 4, 6, 8, 10]
    points = np.array([[a, b] for a in grids[0].cube for b in grids[1].cube])
    assert permitted(study, points).all()


def test_contours_show_what_the_models_say(axis_run):
    from report_runs import NODE

    run = axis_run(
        parameters={
            name: NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
            for name in ("gain", "other")
        }
    )
    analysis = Analysis(run)
    (panel,) = contours(analysis, analysis.answer).panels
    (heatmap,) = [e for e in panel.elements if isinstance(e, Heatmap)]
    edge = named(panel, "50 % likely within limits", Contour)
    x = analysis.study.search_space().to_cube(
        {"gain": float(heatmap.x[7]), "other": float(heatmap.y[11])}
    )[None]
    assert heatmap.z[11, 7] == pytest.approx(analysis.models.objective.predict_mean(x)[0])
    assert edge.z[11, 7] == pytest.approx(np.exp(analysis.models.log_feasibility(x)[0]))
    assert edge.levels == [0.5]
    assert "contours" in [figure.name for figure in surrogates(analysis).figures]


def test_the_map_has_every_evaluation_of_both(analysis):
    (figure,) = contexts(analysis).figures
    default, tuned = figure.panels
    best = analysis.answer.parameters["gain"]
    for panel, gain in ((default, 0.5), (tuned, best)):
        evaluations = [r for r in analysis.record.evaluations if r.parameters["gain"] == gain]
        points = named(panel, "test run", Points)
        assert sorted(points.x) == sorted(evaluation.context["load"] for evaluation in evaluations)
        np.testing.assert_allclose(points.y, 2.0 * gain * np.array(points.x))
        assert named(panel, "limit", Limit).value == 1.0


def test_neighbours_are_a_step_away(analysis):
    (table,) = effects(analysis).tables
    ((name, value, *steps, _),) = table.rows
    gain = analysis.answer.parameters["gain"]
    assert (name, value) == ("gain", f"{gain:.4g}")
    model = analysis.models.objective
    best = model.predict_mean(np.array([[gain]]))[0]
    for cell, step in zip(steps, (-0.05, 0.05), strict=True):
        there = model.predict_mean(np.array([[gain + step]]))[0]
        assert cell.startswith(f"{step:+.3g}: {100.0 * (there / best - 1.0):+.1f} %, ")
        assert cell.endswith("% likely within limits")


def with_metric(analysis, change, unit=""):
    """The run with other values of its objective, and another unit."""

    def changed(evaluation):
        metrics = evaluation.outcome.metrics
        if not metrics:
            return evaluation
        found = {**metrics, "error": change(metrics["error"])}
        return replace(evaluation, outcome=replace(evaluation.outcome, metrics=found))

    study = analysis.study
    metrics = {**study.metrics, "error": replace(study.metrics["error"], unit=unit)}
    trials = tuple(
        replace(trial, evaluations=tuple(map(changed, trial.evaluations)))
        for trial in analysis.record.trials
    )
    evaluations = tuple(map(changed, analysis.record.evaluations))
    study = replace(study, metrics=metrics)
    return Analysis(replace(analysis.record, study=study, trials=trials, evaluations=evaluations))


def test_changes_of_a_negative_objective_are_in_its_unit(analysis):
    """A percentage of it would have the wrong sign."""
    found = with_metric(analysis, lambda error: error - 5.0, "mm")
    (table,) = effects(found).tables
    model, gain = found.models.objective, found.answer.parameters["gain"]
    optimum = model.predict_mean(np.array([[gain]]))[0]
    assert optimum < 0.0
    for cell, step in zip(table.rows[0][2:4], (-0.05, 0.05), strict=True):
        there = model.predict_mean(np.array([[gain + step]]))[0]
        assert cell.startswith(f"{step:+.3g}: {there - optimum:+.3g} mm, ")


def test_an_objective_of_zero_has_no_change_in_percent(analysis):
    (table,) = effects(with_metric(analysis, lambda _: 0.0)).tables
    assert table.rows[0][2].startswith("-0.05: +0, ")


def test_the_heading_of_a_metric_without_a_unit(analysis):
    far = iter([1e6])
    outlying = with_metric(analysis, lambda error: next(far, error))
    assert outlying.models.outliers
    tables = failures(outlying).tables
    assert tables[-1].header == ["trial", "parameters", "mean error"]


def test_an_outlier_is_called_so_on_the_page_of_its_trial(analysis):
    """Its own values may be within the limits."""
    far = iter([1e6])
    outlying = with_metric(analysis, lambda error: next(far, error))
    (number,) = outlying.models.outliers
    (trial,) = [trial for trial in outlying.trials if trial.number == number]
    summary, *_ = trial_sections(outlying, trial)
    assert summary.title == f"Trial {number}: far off"


@pytest.mark.parametrize(
    ("stage", "trial", "whose", "bag"),
    [
        (Stage.DRAWN, 1, "1", "bags/trial_0001"),
        (Stage.CHECK_DRAWN, 1, "1", "bags/check_0001"),
        (Stage.CHECK_WORST, 2, "2", "–"),
        (Stage.VALIDATION, 0, "default", "bags/validation"),
        (Stage.VALIDATION, 1, "tuned", "bags/validation"),
    ],
)
def test_a_failed_evaluation_is_in_the_bag_of_its_stage(
    analysis, tmp_path, stage, trial, whose, bag
):
    for name in ("trial_0000", "trial_0001", "trial_0002", "check_0001", "validation"):
        (tmp_path / "bags" / name).mkdir(parents=True)
    one = next(e for e in analysis.record.evaluations if not e.outcome.complete)
    one = replace(one, stage=stage, trial=trial)
    record = replace(analysis.record, path=tmp_path, evaluations=(one,))
    ((*cells,),) = failures(Analysis(record)).tables[0].rows
    assert (cells[0], cells[-1]) == (whose, bag)


def test_the_most_critical_context_variable_is_named(analysis):
    assert tolerance(analysis).lead.startswith("peak is most sensitive to load")


def test_times_add_up(analysis):
    trials = tuple(
        replace(
            trial,
            seconds=2.0,
            evaluations=tuple(replace(evaluation, seconds=0.5) for evaluation in trial.evaluations),
        )
        for trial in analysis.record.trials
    )
    section = timing(Analysis(replace(analysis.record, trials=trials)))
    n, evaluations = len(trials), sum(len(trial.evaluations) for trial in trials)
    share = 100.0 * 2.0 * n / (2.0 * n + 0.5 * evaluations)
    assert (
        f"took {0.5 * evaluations:.4g} s, proposals {2.0 * n:.4g} s ({share:.0f} %" in section.lead
    )


def test_what_starts_with_other_values_took_is_told(analysis):
    first, second, *others = analysis.record.evaluations
    evaluations = [
        replace(evaluation, outcome=evaluation.outcome.with_starts(*starts))
        for evaluation, starts in zip((first, second), [(2, 3.5), (1, 1.0)], strict=True)
    ]
    record = replace(analysis.record, evaluations=(*evaluations, *others))
    told = "Of the test runs 4.5 s went into 3 starts of nodes with other values, 1.5 s each."
    assert timing(Analysis(record)).lead.endswith(told)
    assert "starts" not in timing(analysis).lead


def test_what_a_machine_needs_between_runs_is_told(analysis):
    first, second, *others = analysis.record.evaluations
    warmed = first.outcome.noted(warm_ups=3, warm_up_seconds=12.5)
    rested = second.outcome.noted(rested_seconds=30.0)
    record = replace(
        analysis.record,
        evaluations=(replace(first, outcome=warmed), replace(second, outcome=rested), *others),
    )
    assert timing(Analysis(record)).lead.endswith(
        " For 30 s of the test runs the machine was at rest. Beside these, 3 runs to warm up took "
        "12.5 s."
    )
    lead = timing(analysis).lead
    assert "at rest" not in lead
    assert "warm up" not in lead


def test_the_time_of_ramps_is_told(analysis):
    first, *others = analysis.record.evaluations
    ramped = first.outcome.noted(ramped_seconds=6.0)
    record = replace(analysis.record, evaluations=(replace(first, outcome=ramped), *others))
    told = " For 6 s the parameters were on their way to others."
    assert timing(Analysis(record)).lead.endswith(told)
    assert "on their way" not in timing(analysis).lead


def test_a_record_without_times_is_told():
    # As of a journal before times were recorded: the section says so instead of dividing by 0.
    class Untimed:
        def __init__(self, record):
            self.record = record

    class Record:
        evaluations = ()

    from bo_tuner.trials import Trial, TrialState

    record = Record()
    record.trials = (Trial(0, {"gain": 0.5}, "", TrialState.COMPLETE),)
    assert timing(Untimed(record)).lead == "The record holds no times."


def test_an_integer_is_shown_in_full():
    assert content.number(12345) == "12345"
    assert content.number(12345.0) == "1.234e+04"
