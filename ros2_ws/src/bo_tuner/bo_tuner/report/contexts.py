"""Where the worst case lies: the cuts of default and tuned parametrization over the contexts."""

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
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, quantity, values
from bo_tuner.seeds import Stream, generator
from bo_tuner.study import Metric, Study
from bo_tuner.surrogate.gaussian_process import GaussianProcess
from bo_tuner.trials import Cut

FEWEST_FOR_A_FIELD = 8
"""With fewer cuts a field between them would be guesswork."""

FIELD_POINTS = 31
MOST_VARIABLES = 3
"""Pairs are drawn of so many context variables, the first ones of the study."""


def contexts(analysis: Analysis) -> Section | None:
    """Show the constrained metric over the contexts; None in a study without contexts."""
    study = analysis.study
    if not study.contexts:
        return None
    sides = [("default", analysis.cuts_of(analysis.defaults))]
    if analysis.answer is not None:
        sides.append(("tuned", analysis.cuts_of(analysis.answer.parameters)))
    sides = [(name, cuts) for name, cuts in sides if cuts]
    if not sides:
        return None
    metric, limit = _metric(study)
    worst = [
        (name, max(cuts, key=lambda c: c.outcome.metrics[metric.name])) for name, cuts in sides
    ]
    said = "; ".join(
        f"{name}: {quantity(cut.outcome.metrics[metric.name], metric.unit)} at "
        f"{values(cut.context)}"
        for name, cut in worst
    )
    bound = ""
    if limit is not None:
        above = "; ".join(f"{name} {_above(cuts, metric, limit)}" for name, cuts in sides)
        bound = f" Single cuts above the limit of {quantity(limit, metric.unit)}: {above}."
    return Section(
        name="contexts",
        title="Which contexts are the worst",
        lead=f"Largest {metric.name} seen: {said}.{bound}",
        figures=[_map(study, sides, metric, limit)],
    )


def _metric(study: Study) -> tuple[Metric, float | None]:
    """Return the metric of the worst case and its limit, or the objective's and None."""
    worst = study.worst_case_constraint
    if worst is None:
        return study.metrics[study.objective.metric], None
    return study.metrics[worst.metric], worst.upper


Side = tuple[str, list[Cut]]


def _map(study: Study, sides: Sequence[Side], metric: Metric, limit: float | None) -> Figure:
    seen = [cut.outcome.metrics[metric.name] for _, cuts in sides for cut in cuts]
    names = study.context_space().names
    colors = _colors(metric, seen, limit)
    if len(names) == 1:
        # The same range on both sides, for a fair look.
        ends = [*seen, *([] if limit is None else [limit])]
        margin = 0.05 * ((max(ends) - min(ends)) or abs(max(ends)) or 1.0)
        y = Axis(
            label=metric.name, unit=metric.unit, limits=(min(ends) - margin, max(ends) + margin)
        )
        panels = [_panel_1d(study, side, metric, limit, y) for side in sides]
    else:
        pairs = list(itertools.combinations(names[:MOST_VARIABLES], 2))
        panels = [
            _panel_2d(study, side, metric, colors, limit, pair) for pair in pairs for side in sides
        ]
    return Figure(
        name="contexts",
        title=f"Every cut of default and tuned over the contexts, by {metric.name}",
        caption="A point is a cut, in any stage of the run. The field between the points is a "
        "Gaussian process through them; the line is the limit. The search looks for the worst "
        "case, so cuts crowd where the metric is large.",
        alternative="; ".join(_said(side, metric) for side in sides),
        panels=panels,
        columns=min(2, len(panels)),
        panel_height=380,
    )


def _panel_1d(study: Study, side: Side, metric: Metric, limit: float | None, y: Axis) -> Panel:
    name, cuts = side
    (variable,) = study.context_space().names
    elements: list[Element] = [
        Points(
            x=[cut.context[variable] for cut in cuts],
            y=[cut.outcome.metrics[metric.name] for cut in cuts],
            name="cut",
            color=Color.BLUE,
            filled=False,
            hover=[_cut_said(cut, metric) for cut in cuts],
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
    name, cuts = side
    a, b = pair
    elements: list[Element] = []
    if len(study.contexts) == 2 and len(cuts) >= FEWEST_FOR_A_FIELD:
        x, y, z = _field(study, cuts, metric)
        elements.append(Heatmap(x=x, y=y, z=z, colors=colors))
        if limit is not None:
            elements.append(
                Contour(x=x, y=y, z=z, levels=[limit], name="limit", color=Color.BLACK, width=2.0)
            )
    elements.append(
        Points(
            x=[cut.context[a] for cut in cuts],
            y=[cut.context[b] for cut in cuts],
            name="cut",
            color=Color.INK,
            marker=Marker.CIRCLE,
            values=[cut.outcome.metrics[metric.name] for cut in cuts],
            colors=colors,
            hover=[_cut_said(cut, metric) for cut in cuts],
        )
    )
    return Panel(
        title=name,
        x=_axis(study, a),
        y=_axis(study, b),
        elements=elements,
    )


def _axis(study: Study, name: str) -> Axis:
    variable = study.contexts[name]
    lower, upper = variable.distribution.lower, variable.distribution.upper
    return Axis(label=name, unit=variable.unit, limits=(lower, upper))


def _field(
    study: Study, cuts: Sequence[Cut], metric: Metric
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes and posterior mean (rows, columns) of the metric over two context variables."""
    space = study.context_space()
    points = space.to_cube([[cut.context[name] for name in space.names] for cut in cuts])
    seen = [cut.outcome.metrics[metric.name] for cut in cuts]
    model = GaussianProcess.fit(points, seen, rng=generator(study.seed, Stream.SEARCH, 2**31))
    unit = np.linspace(0.0, 1.0, FIELD_POINTS)
    grid = np.stack(np.meshgrid(unit, unit), axis=-1).reshape(-1, 2)
    z = model.predict_mean(grid).reshape(FIELD_POINTS, FIELD_POINTS)
    width = space.upper - space.lower
    return space.lower[0] + unit * width[0], space.lower[1] + unit * width[1], z


def _colors(metric: Metric, seen: Sequence[float], limit: float | None) -> ColorScale:
    low, high = min(seen), max(seen)
    if limit is not None:
        # Equal steps to both sides, so that equal distances have equal colours.
        reach = max(limit - low, high - limit) or abs(limit) or 1.0
        low, high = limit - reach, limit + reach
    elif not low < high:
        low, high = low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)
    return ColorScale(label=metric.name, unit=metric.unit, low=low, high=high, middle=limit)


def _above(cuts: Sequence[Cut], metric: Metric, limit: float) -> str:
    above = sum(cut.outcome.metrics[metric.name] > limit for cut in cuts)
    return f"{above} of {len(cuts)}"


def _said(side: Side, metric: Metric) -> str:
    name, cuts = side
    seen = [cut.outcome.metrics[metric.name] for cut in cuts]
    low, high = quantity(min(seen), metric.unit), quantity(max(seen), metric.unit)
    return f"{name}: {len(cuts)} cuts from {low} to {high}"


def _cut_said(cut: Cut, metric: Metric) -> str:
    found = quantity(cut.outcome.metrics[metric.name], metric.unit)
    return f"{metric.name} {found}\n{values(cut.context)}\n{cut.stage} cut, seed {cut.seed}"
