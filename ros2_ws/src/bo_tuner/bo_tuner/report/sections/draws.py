"""The draws of the verdict against each limit, default beside tuned."""

from collections.abc import Sequence
from math import isfinite, isnan

import numpy as np

from bo_tuner.evidence.words.limits import in_words
from bo_tuner.evidence.words.quantities import details
from bo_tuner.evidence.words.verdict import basis
from bo_tuner.figures.figure import Axis, Dash, Element, Figure, Limit, Line, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, quantity
from bo_tuner.report.marks import RESULT
from bo_tuner.report.sections.trajectories import STYLES
from bo_tuner.study.constraint import Constraint


def draws(analysis: Analysis) -> Section | None:
    """Show the distribution of each limited metric; None without a result or limits."""
    verdict = analysis.verdict
    study = analysis.study
    if verdict.observed is None or not study.constraints:
        return None
    panels = [_panel(analysis, constraint) for constraint in study.constraints.values()]
    sentences = [
        f"{q.label}: {'; '.join(filter(None, (in_words(q.limit_verdict), details(q))))}"
        for q in verdict.quantities
        if q.limit_verdict is not None
    ]
    bound = ""
    if any(isfinite(quantity.bound) for quantity in verdict.quantities):
        bound = " Dotted: confidence bound of the tuned worst-case mean, by the certificate."
    return Section(
        name="draws",
        title="How often is each limit kept?",
        lead=f"Default and tuned parameter set in {basis(verdict)}.",
        figures=[
            Figure(
                name="draws",
                title="Share of the test runs up to each value",
                caption=f"The part of a line beyond the limit is the share over it.{bound}",
                alternative="; ".join(sentences) or "Empirical distributions of the test runs.",
                panels=panels,
                columns=min(2, len(panels)),
                panel_height=300,
            )
        ],
    )


def _panel(analysis: Analysis, constraint: Constraint) -> Panel:
    verdict, metric = analysis.verdict, analysis.study.metrics[constraint.metric]
    elements: list[Element] = [Limit(value=constraint.limit, name="limit", vertical=True)]
    for q in verdict.quantities:
        if q.constraint == constraint.name and isfinite(q.bound):
            elements.append(
                Limit(
                    value=q.bound,
                    name="bound of the tuned worst case",
                    vertical=True,
                    color=RESULT[0],
                    dash=Dash.DOTTED,
                )
            )
    for (name, (color, dash)), side in zip(STYLES.items(), verdict.observed or (), strict=True):
        values = np.sort([m[metric.name] for m in side.drawn.values() if metric.name in m])
        if not len(values) or isnan(values[0]):
            continue
        # A failed draw has no value, so the line ends below 100 %.
        shares = 100.0 * np.arange(1, len(values) + 1) / max(side.draws, len(values))
        elements.append(
            Line(
                x=np.concatenate([values[:1], values]),
                y=np.concatenate([[0.0], shares]),
                name=name,
                color=color,
                dash=dash,
                step=True,
                hover=[
                    f"{name}: {share:.3g} % up to {quantity(value, metric.unit)}"
                    for value, share in zip([values[0], *values], [0.0, *shares], strict=True)
                ],
            )
        )
    return Panel(
        title=analysis.study.limit_title(constraint),
        x=Axis(label=metric.title, unit=metric.unit, limits=_around(elements)),
        y=Axis(label="test runs", unit="%", limits=(0.0, 101.0)),
        elements=elements,
    )


def _around(elements: Sequence[Element]) -> tuple[float, float]:
    """Return a range in which all lines are, none of them at its end; from 0 if all are above."""
    shown = [e.value for e in elements if isinstance(e, Limit)]
    shown += [float(x) for e in elements if isinstance(e, Line) for x in e.x]
    low, high = min(shown), max(shown)
    from_zero = low > 0.0
    margin = 0.03 * ((high - low) or abs(high) or 1.0)
    return 0.0 if from_zero else low - margin, high + margin
