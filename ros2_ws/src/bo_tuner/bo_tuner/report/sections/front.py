"""The Pareto front of a study with several objectives."""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bo_tuner.evidence.trial_row import OF_VALUE, TrialOutcome
from bo_tuner.evidence.words.next_steps import Step, to_use
from bo_tuner.figures.figure import (
    Color,
    Dash,
    Element,
    Figure,
    Line,
    Marker,
    Panel,
    Points,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Choice, Section, Table, number
from bo_tuner.report.marks import OFF_SCALE
from bo_tuner.report.sections.convergence import (
    beyond,
    describe,
    mean_axis,
    scale_end,
    trial_points,
)
from bo_tuner.report.sections.trajectories import response_of
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.text import counted, percent, with_unit
from bo_tuner.trials import Trial
from bo_tuner.tuning.front import CONFIDENCE, RULE, Mean, Point, pareto_front

MOST_RESPONSES = 12
"""Points of the front with a response: each is simulated in several contexts."""


def front_figure(analysis: Analysis) -> Figure | None:
    """Return the front as a figure; None with one objective, or without a point on it."""
    points = _points(analysis)
    return _figure(analysis, points) if points else None


def _points(analysis: Analysis) -> Sequence[Point]:
    if len(analysis.study.objectives) == 1:
        return ()
    return pareto_front(analysis.study, analysis.ranked)


def front(analysis: Analysis) -> Section | None:
    """Show the points of the front, each of which opens; None without any."""
    points = _points(analysis)
    if not points:
        return None
    answer = analysis.answer
    result = None if answer is None else answer.number
    # A run that found no feasible parameter set has a result that was not chosen from the front.
    chosen = any(point.trial == analysis.verdict.trial for point in points)
    rule = f" The result is {RULE}." if chosen else ""
    return Section(
        name="front",
        title="Which compromises are there?",
        lead=f"The front has {counted(len(points), 'parameter set')} likely within limits: no "
        f"other such trial is as good in every objective, and better in one.{rule}",
        notes=[f"Only the result was validated in fresh test runs; {_of_others(points)}."],
        choices=_choices(analysis, points, result),
    )


def _choices(analysis: Analysis, points: Sequence[Point], result: int | None) -> list[Choice]:
    """Return what to know of each point to choose it instead of the result."""
    by_number = {trial.number: trial for trial in analysis.trials}
    return [
        Choice(
            trial=point.trial,
            title=_in_a_line(analysis.study, point, is_result=point.trial == result),
            values=_values(analysis, by_number[point.trial]),
            steps=_steps(analysis, point, result),
            # A page of a run in progress does without: simulated, they take longer than a trial.
            figure=None
            if analysis.quick or place >= MOST_RESPONSES
            else response_of(analysis, by_number[point.trial]),
        )
        for place, point in enumerate(points)
    ]


def steps_of_front(analysis: Analysis) -> list[Step]:
    """Return the commands that the points of the front have."""
    result = None if analysis.answer is None else analysis.answer.number
    return [step for point in _points(analysis) for step in _steps(analysis, point, result)]


def _steps(analysis: Analysis, point: Point, result: int | None) -> tuple[Step, ...]:
    # Commands do not reach a function, and those for the result stand with it.
    if analysis.record.backend == FUNCTION or point.trial == result:
        return ()
    return to_use(str(analysis.record.path.resolve()), point.trial)


def _in_a_line(study: Study, point: Point, *, is_result: bool) -> str:
    """Return what a point is, in a line."""
    means = ", ".join(
        f"{metric.title} {_in_words(point.means[metric.name])} {metric.unit}".rstrip()
        for metric in (study.metrics[item.metric] for item in study.objectives)
    )
    likely = f"{percent(point.feasibility)} likely within limits"
    return f"Trial {point.trial}{', the result' if is_result else ''}: {means}; {likely}"


def _values(analysis: Analysis, trial: Trial) -> Table:
    """Return the tuned parameters of a trial, beside those of the answer and of the default."""
    study, answer = analysis.study, analysis.answer
    names = study.tuned_names
    columns = {f"trial {trial.number}": trial.parameters, "default": analysis.defaults}
    if answer is not None and answer.number != trial.number:
        columns = {**columns, analysis.answer_name: answer.parameters}
    return Table(
        caption=f"Parameters of trial {trial.number}",
        header=["parameter", *columns],
        rows=[
            [
                with_unit(study.parameters[name].title_and_name, study.parameters[name].unit),
                *(number(values[name]) for values in map(study.on_screen, columns.values())),
            ]
            for name in names
        ],
        numeric=[*range(1, 1 + len(columns))],
    )


def _of_others(points: Sequence[Point]) -> str:
    if points[0].modelled:
        return "the means of the others are those that the models of all test runs predict"
    return (
        "the means of the others are those of their own test runs, the best of which are biased "
        "by selection"
    )


def _which_means(points: Sequence[Point]) -> str:
    if points[0].modelled:
        return "Means by the models of all test runs"
    return "Means over the test runs of each trial in drawn contexts"


def _figure(analysis: Analysis, points: Sequence[Point]) -> Figure:
    study, objectives = analysis.study, analysis.study.objectives
    names = " against ".join(study.metrics[objective.metric].title for objective in objectives)
    return Figure(
        name="front",
        title=f"Means of {names}, all trials",
        caption=f"{_which_means(points)}; the bars are {100 * CONFIDENCE:g} % intervals of those "
        "on the front. The other trials within limits are dominated by these, up to the noise.",
        alternative="; ".join(
            f"trial {point.trial}: "
            + ", ".join(
                f"{study.metrics[name].title} {number(mean.value)}"
                for name, mean in point.means.items()
            )
            for point in points
        ),
        panels=[_panel(analysis, points, pair) for pair in combinations(objectives, 2)],
        columns=1 if len(objectives) == 2 else 2,
        panel_height=280,
    )


def _panel(analysis: Analysis, points: Sequence[Point], pair: tuple[Objective, Objective]) -> Panel:
    first, second = (item.metric for item in pair)
    across, up = (mean_axis(analysis.study, objective) for objective in pair)
    # Off the charts are outliers: they would leave no room for the others.
    trials = [t for t in analysis.trials if analysis.outcome(t) in OF_VALUE]
    on_front = {point.trial: point.means for point in points}
    x, y = (
        np.array(
            [
                on_front[t.number][name].value
                if t.number in on_front
                else analysis.estimate(t, name).value
                for t in trials
            ]
        )
        for name in (first, second)
    )
    good = [analysis.outcome(trial) is TrialOutcome.WITHIN for trial in trials]
    seen = (x, y)
    (x, far_across), (y, far_up) = (
        _up_to_end(values, scale_end(good, values, axis.scale, objective.sign, ()), objective.sign)
        for values, axis, objective in zip(seen, (across, up), pair, strict=True)
    )
    far = np.flatnonzero(far_across | far_up)
    near = np.flatnonzero(~(far_across | far_up))
    elements: list[Element] = []
    if len(analysis.study.objectives) == 2:
        elements.append(
            Line(
                x=[p.means[first].value for p in points],
                y=[p.means[second].value for p in points],
                name="Pareto front",
                color=Color.INK,
                dash=Dash.DOTTED,
            )
        )
    elements += [
        Line(
            x=[v for p in points for v in _across(p.means[first], p.means[second])[0]],
            y=[v for p in points for v in _across(p.means[first], p.means[second])[1]],
            name=f"{100 * CONFIDENCE:g} % interval",
            color=Color.GRAY,
        ),
        *trial_points(analysis, [trials[k] for k in near], x[near], y[near]),
        Points(
            x=[p.means[first].value for p in points],
            y=[p.means[second].value for p in points],
            name="on the front",
            color=Color.INK,
            marker=Marker.CIRCLE,
            filled=False,
            size=12,
            hover=[
                f"trial {p.trial}\n{across.label} {_in_words(p.means[first])}\n"
                f"{up.label} {_in_words(p.means[second])}"
                for p in points
            ],
            trials=[p.trial for p in points],
        ),
    ]
    if len(far):
        elements.append(
            Points(
                x=x[far],
                y=y[far],
                name="off the scale",
                color=OFF_SCALE[0],
                marker=OFF_SCALE[1],
                size=9,
                hover=[
                    f"{describe(analysis, trials[k])}\n{across.label} {number(float(seen[0][k]))}\n"
                    f"{up.label} {number(float(seen[1][k]))}"
                    for k in far
                ],
                trials=[trials[k].number for k in far],
            )
        )
    return Panel(x=across, y=up, elements=elements)


def _up_to_end(values: Array, end: float, sign: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return values (n,) with those beyond the end of a scale at it, and which these are."""
    far = beyond(values, end, sign)
    return np.where(far, end, values), far


def _across(x: Mean, y: Mean) -> tuple[list[float], list[float]]:
    """Return the two bars of a point, with a gap after each."""
    gap = math.nan
    return (
        [x.value - x.error, x.value + x.error, gap, x.value, x.value, gap],
        [y.value, y.value, gap, y.value - y.error, y.value + y.error, gap],
    )


def _in_words(mean: Mean) -> str:
    if math.isnan(mean.error):
        return number(mean.value)
    return f"{number(mean.value)} ± {mean.error:.2g}"
