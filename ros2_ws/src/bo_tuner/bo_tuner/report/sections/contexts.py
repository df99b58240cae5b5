"""The worst case: evaluations of the default and the tuned parameter set over the contexts."""

import itertools
from collections.abc import Sequence

import numpy as np

from bo_tuner.figures.figure import (
    Axis,
    Color,
    ColorScale,
    Contour,
    Element,
    Figure,
    Heatmap,
    Limit,
    Marker,
    Panel,
    Points,
)
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, numbered, quantity
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.metrics import Metric
from bo_tuner.study.study import Study
from bo_tuner.text import counted, shown, values
from bo_tuner.trials import Evaluation

FEWEST_FOR_A_FIELD = 8
"""With fewer evaluations no model is fitted."""

FIELD_POINTS = 31
MOST_VARIABLES = 3
"""Pairs of the first context variables of the study are drawn, up to this number."""


def contexts(analysis: Analysis) -> Section | None:
    """Show the constrained metric over the contexts; None in a study without contexts."""
    study = analysis.study
    if not study.contexts:
        return None
    sides = [("default", analysis.evaluations_of(analysis.defaults))]
    if analysis.answer is not None:
        sides.append((analysis.answer_name, analysis.evaluations_of(analysis.answer.parameters)))
    sides = [(name, evaluations) for name, evaluations in sides if evaluations]
    if not sides:
        return None
    # Without a worst-case limit, the contexts matter for the objective.
    shown: Sequence[Constraint | None] = study.worst_case_constraints or (None,)
    return Section(
        name="contexts",
        title="Where is it worst?",
        lead=" ".join(_lead(study, sides, constraint) for constraint in shown),
        figures=[
            _map(study, sides, constraint, numbered("contexts", k))
            for k, constraint in enumerate(shown)
        ],
    )


Side = tuple[str, list[Evaluation]]


def _lead(study: Study, sides: Sequence[Side], constraint: Constraint | None) -> str:
    """Name the worst evaluation of each side, and how many violate the limit."""
    metric = _metric(study, constraint)
    sign = study.objective.sign if constraint is None else constraint.sign
    worst_of_sides = "; ".join(
        f"{name}: {quantity(worst.outcome.metrics[metric.name], metric.unit)} at "
        f"{values(worst.context)}"
        for name, evaluations in sides
        for worst in (max(evaluations, key=lambda e: sign * e.outcome.metrics[metric.name]),)
    )
    extreme = "Largest" if sign > 0.0 else "Smallest"
    where = "in the tuning run (without those of certificates)"
    text = f"{extreme} {metric.title} {where}: {worst_of_sides}."
    if constraint is None:
        return text
    limit = quantity(constraint.limit, metric.unit)
    counts = "; ".join(
        f"{name} {_violating(evaluations, constraint)}" for name, evaluations in sides
    )
    return f"{text} Test runs {constraint.beyond} the limit of {limit}: {counts}."


def _metric(study: Study, constraint: Constraint | None) -> Metric:
    """Return the metric of a constraint, or else the objective's."""
    return study.metrics[study.objective.metric if constraint is None else constraint.metric]


def _map(study: Study, sides: Sequence[Side], constraint: Constraint | None, name: str) -> Figure:
    metric = _metric(study, constraint)
    limit = None if constraint is None else constraint.limit
    seen = [
        evaluation.outcome.metrics[metric.name]
        for _, evaluations in sides
        for evaluation in evaluations
    ]
    names = study.context_space().names
    colors = _colors(metric, seen, limit)
    if len(names) == 1:
        # The same range on both sides, so that they can be compared.
        ends = [*seen, *([] if limit is None else [limit])]
        margin = 0.05 * ((max(ends) - min(ends)) or abs(max(ends)) or 1.0)
        y = Axis(
            label=metric.title, unit=metric.unit, limits=(min(ends) - margin, max(ends) + margin)
        )
        panels = [_panel_1d(study, side, metric, limit, y) for side in sides]
    else:
        pairs = list(itertools.combinations(names[:MOST_VARIABLES], 2))
        panels = [
            _panel_2d(study, side, metric, colors, limit, pair) for pair in pairs for side in sides
        ]
    return Figure(
        name=name,
        title=f"{metric.title} over the contexts: {' and '.join(name for name, _ in sides)}",
        caption="Each point is a test run, the colours between them a model, the line the limit.",
        alternative="; ".join(_summary(side, metric) for side in sides),
        panels=panels,
        columns=min(2, len(panels)),
        panel_height=380,
    )


def _panel_1d(study: Study, side: Side, metric: Metric, limit: float | None, y: Axis) -> Panel:
    name, evaluations = side
    (variable,) = study.context_space().names
    elements: list[Element] = [
        Points(
            x=_numbers(study, variable, evaluations),
            y=[evaluation.outcome.metrics[metric.name] for evaluation in evaluations],
            name="test run",
            color=Color.BLUE,
            filled=False,
            hover=[_describe(evaluation, metric) for evaluation in evaluations],
        )
    ]
    if limit is not None:
        elements.append(Limit(value=limit, name="limit"))
    return Panel(
        title=name,
        x=_axis(study, variable),
        y=y,
        elements=elements,
    )


def _panel_2d(
    study: Study,
    side: Side,
    metric: Metric,
    colors: ColorScale,
    limit: float | None,
    pair: tuple[str, str],
) -> Panel:
    name, evaluations = side
    a, b = pair
    elements: list[Element] = []
    is_plane = len(study.contexts) == len(study.context_space().ordered) == 2
    if is_plane and len(evaluations) >= FEWEST_FOR_A_FIELD:
        x, y, z = _field(study, evaluations, metric)
        elements.append(Heatmap(x=x, y=y, z=z, colors=colors))
        if limit is not None:
            elements.append(
                Contour(x=x, y=y, z=z, levels=[limit], name="limit", color=Color.BLACK, width=2.0)
            )
    elements.append(
        Points(
            x=_numbers(study, a, evaluations),
            y=_numbers(study, b, evaluations),
            name="test run",
            color=Color.INK,
            marker=Marker.CIRCLE,
            values=[evaluation.outcome.metrics[metric.name] for evaluation in evaluations],
            colors=colors,
            hover=[_describe(evaluation, metric) for evaluation in evaluations],
        )
    )
    return Panel(
        title=name,
        x=_axis(study, a),
        y=_axis(study, b),
        elements=elements,
    )


def _numbers(study: Study, name: str, evaluations: Sequence[Evaluation]) -> list[float]:
    """Return the positions of evaluations along the axis of a context variable."""
    distribution = study.contexts[name].distribution
    return [distribution.number(evaluation.context[name]) for evaluation in evaluations]


def _axis(study: Study, name: str) -> Axis:
    variable = study.contexts[name]
    lower, upper = variable.distribution.lower, variable.distribution.upper
    labels = enumerate(variable.distribution.labels)
    ticks = [(float(position), shown(label)) for position, label in labels]
    return Axis(label=name, unit=variable.unit, limits=(lower, upper), ticks=ticks)


def _field(
    study: Study, evaluations: Sequence[Evaluation], metric: Metric
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes and posterior mean (rows, columns) of the metric over two context variables."""
    space = study.context_space()
    points = space.cube_of([evaluation.context for evaluation in evaluations])
    seen = [evaluation.outcome.metrics[metric.name] for evaluation in evaluations]
    model = GaussianProcess.fit(points, seen, rng=generator(study.seed, Stream.SEARCH, 2**31))
    unit = np.linspace(0.0, 1.0, FIELD_POINTS)
    grid = np.stack(np.meshgrid(unit, unit), axis=-1).reshape(-1, 2)
    z = model.predict_mean(grid).reshape(FIELD_POINTS, FIELD_POINTS)
    width = space.upper - space.lower
    return space.lower[0] + unit * width[0], space.lower[1] + unit * width[1], z


def _colors(metric: Metric, seen: Sequence[float], limit: float | None) -> ColorScale:
    low, high = min(seen), max(seen)
    if limit is not None:
        # Symmetric about the limit, so that equal distances from it are equally saturated.
        reach = max(limit - low, high - limit) or abs(limit) or 1.0
        low, high = limit - reach, limit + reach
    elif not low < high:
        low, high = low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)
    return ColorScale(label=metric.title, unit=metric.unit, low=low, high=high, middle=limit)


def _violating(evaluations: Sequence[Evaluation], constraint: Constraint) -> str:
    seen = [evaluation.outcome.metrics[constraint.metric] for evaluation in evaluations]
    return f"{np.sum(constraint.violations(seen))} of {len(seen)}"


def _summary(side: Side, metric: Metric) -> str:
    name, evaluations = side
    seen = [evaluation.outcome.metrics[metric.name] for evaluation in evaluations]
    low, high = quantity(min(seen), metric.unit), quantity(max(seen), metric.unit)
    return f"{name}: {counted(len(evaluations), 'test run')} from {low} to {high}"


def _describe(evaluation: Evaluation, metric: Metric) -> str:
    value = quantity(evaluation.outcome.metrics[metric.name], metric.unit)
    origin = f"stage {evaluation.stage}, seed {evaluation.seed}"
    return f"{metric.title} {value}\n{values(evaluation.context)}\n{origin}"
