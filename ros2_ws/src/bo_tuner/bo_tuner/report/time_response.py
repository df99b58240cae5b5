"""Limits in a time response: where a signal is beyond one, the run violates it.

They belong to metrics that are the largest or smallest value of a signal, or how far a signal goes
beyond another one: the metric's value is what is between the two.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.figures.figure import Band, Color, Dash, Element, Line, Panel
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.study import Study

ZERO = " = 0"
"""Ends the name of a traced signal at which the metric before it is 0, as ``overshoot = 0``."""
MARGIN = 0.06
"""Space above and below the lines, as a share of their range."""
EXTREMES = {"maximum": 1.0, "minimum": -1.0}
"""Measures of a signal that a limit on its side bounds at all times, and the sign of that."""


@dataclass(frozen=True)
class Responses:
    """The signals of default and answer over time.

    Attributes
    ----------
    panels
        All of them, row by row.
    columns
        Number of panels in a row.
    lead
        Which runs are shown, or why none is.
    caption
        How to read them.
    """

    panels: Sequence[Panel]
    columns: int
    lead: str
    caption: str = ""


@dataclass(frozen=True)
class Bound:
    """A limit on a signal over time.

    Attributes
    ----------
    name
        What is limited, as screens call it.
    x, y
        Times (n,) and the limit (n,) at them.
    sign
        1 for an upper limit, -1 for a lower one.
    """

    name: str
    x: Array
    y: Array
    sign: float


def is_zero_of(name: str) -> str:
    """Return the metric that is 0 at a traced signal, by its name; empty if there is none."""
    last = name.rpartition("/")[2]
    return last.removesuffix(ZERO) if last.endswith(ZERO) else ""


def bounds_beside(study: Study, name: str, x: Array, y: Array) -> list[Bound]:
    """Return the limits on a metric that is 0 where its signal is at y (n,), at times x (n,)."""
    return [
        Bound(study.limited(constraint), x, y + constraint.limit, constraint.sign)
        for constraint in study.constraints.values()
        if constraint.metric == name
    ]


def bounds_of_signal(study: Study, name: str, end: float) -> list[Bound]:
    """Return the limits on the largest or smallest value of a signal, up to `end` [s]."""
    bounds = []
    for constraint in study.constraints.values():
        metric = study.metrics[constraint.metric]
        if (
            isinstance(metric, SignalMetric)
            and metric.of.strip() == name
            and EXTREMES.get(metric.measure) == constraint.sign
        ):
            y = np.full(2, constraint.limit)
            bounds.append(Bound(metric.title, np.array([0.0, end]), y, constraint.sign))
    return bounds


def shaded(panel: Panel, bounds: Sequence[Bound]) -> Panel:
    """Return a panel with limits, and with what is beyond them shaded."""
    if not bounds:
        return panel
    seen = np.concatenate(
        [np.asarray(e.y, dtype=float) for e in panel.elements if isinstance(e, Line)]
        + [bound.y for bound in bounds]
    )
    low, high = float(np.nanmin(seen)), float(np.nanmax(seen))
    margin = MARGIN * ((high - low) or abs(high) or 1.0)
    low, high = low - margin, high + margin
    below: list[Element] = []
    for bound in bounds:
        edge = np.full(len(bound.y), high if bound.sign > 0.0 else low)
        below.append(
            Band(
                x=bound.x,
                lower=np.minimum(bound.y, edge),
                upper=np.maximum(bound.y, edge),
                name=f"over the limit of {bound.name}",
                color=Color.VERMILION,
            )
        )
        below.append(
            Line(
                x=bound.x,
                y=bound.y,
                name=f"limit of {bound.name}",
                color=Color.VERMILION,
                dash=Dash.DASHED,
                width=1.3,
            )
        )
    return replace(
        panel, y=replace(panel.y, limits=(low, high)), elements=[*below, *panel.elements]
    )
