"""The Pareto front of a study with several objectives."""

import math
import shlex
from collections.abc import Sequence
from itertools import combinations

import numpy as np

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
from bo_tuner.report.analysis import OF_VALUE, Analysis
from bo_tuner.report.content import Section, Table, number
from bo_tuner.report.sections.convergence import mean_axis, trial_points
from bo_tuner.study.parts import Objective
from bo_tuner.text import with_unit
from bo_tuner.tuning.front import CONFIDENCE, RULE, Mean, Point, pareto_front


def front(analysis: Analysis) -> Section | None:
    """Show the front; None with one objective, or without a point on it."""
    objectives = analysis.study.objectives
    if len(objectives) == 1:
        return None
    points = pareto_front(analysis.study, analysis.ranked)
    if not points:
        return None
    answer = analysis.answer
    result = None if answer is None else answer.number
    # A run that found no feasible parameter set has a result that was not chosen from the front.
    chosen = any(point.trial == analysis.verdict.trial for point in points)
    rule = f" The result is {RULE}." if chosen else ""
    run = shlex.quote(str(analysis.record.path.resolve()))
    return Section(
        name="front",
        title="Which compromises are there?",
        lead=f"{len(points)} parameter sets that are likely within limits are on the front: "
        f"no other such trial dominates them.{rule}",
        figures=[_figure(analysis, points)],
        tables=[_table(analysis, points, result)],
        notes=[
            f"Only the result was validated on fresh draws; {_of_others(points)}. To use one of "
            "them: "
            f"validate {run} --trial N, then apply {run} --trial N."
        ],
    )


def _of_others(points: Sequence[Point]) -> str:
    if points[0].modelled:
        return "the means of the others are those that the models of all test runs predict"
    return (
        "the means of the others are those of their own test runs, the best of which are biased "
        "by selection"
    )


def _which_means(points: Sequence[Point]) -> str:
    own = "over the test runs of each trial in drawn contexts"
    if points[0].modelled:
        return f"On the front, means by the models of all test runs; elsewhere, {own}"
    return f"Means {own}"


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
    )


def _panel(analysis: Analysis, points: Sequence[Point], pair: tuple[Objective, Objective]) -> Panel:
    first, second = (item.metric for item in pair)
    across, up = (mean_axis(analysis.study, objective) for objective in pair)
    # Off the charts are outliers: they would leave no room for the others.
    trials = [t for t in analysis.trials if analysis.outcome(t) in OF_VALUE]
    x, y = (np.array([_or_nan(t.mean(name)) for t in trials]) for name in (first, second))
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
        *trial_points(analysis, trials, x, y),
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
    return Panel(x=across, y=up, elements=elements)


def _across(x: Mean, y: Mean) -> tuple[list[float], list[float]]:
    """Return the two bars of a point, with a gap after each."""
    gap = math.nan
    return (
        [x.value - x.error, x.value + x.error, gap, x.value, x.value, gap],
        [y.value, y.value, gap, y.value - y.error, y.value + y.error, gap],
    )


def _table(analysis: Analysis, points: Sequence[Point], result: int | None) -> Table:
    study = analysis.study
    names = list(study.search_space().names)
    by_number = {trial.number: trial for trial in analysis.trials}
    header = ["trial"]
    for metric in (study.metrics[item.metric] for item in study.objectives):
        header += [with_unit(f"mean {metric.title}", metric.unit), f"± of {metric.title}"]
    header += ["test runs", "likely within limits [%]"]
    header += [study.parameters[name].title for name in names]
    return Table(
        caption="The front, by the first objective",
        header=header,
        rows=[
            [
                str(point.trial),
                *(number(v) for mean in point.means.values() for v in (mean.value, mean.error)),
                str(next(iter(point.means.values())).count),
                f"{100.0 * point.feasibility:.0f}",
                *(number(by_number[point.trial].parameters[name]) for name in names),
            ]
            for point in points
        ],
        numeric=list(range(len(header))),
        sortable=True,
        marked=[k for k, point in enumerate(points) if point.trial == result],
    )


def _in_words(mean: Mean) -> str:
    if math.isnan(mean.error):
        return number(mean.value)
    return f"{number(mean.value)} ± {mean.error:.2g}"


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
