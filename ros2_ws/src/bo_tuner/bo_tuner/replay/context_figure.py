"""The figure of an identification: where each context may be, before and after."""

import numpy as np

from bo_tuner.figures.figure import Axis, Color, Dash, Figure, Limit, Line, Panel
from bo_tuner.numerics.arrays import Array
from bo_tuner.replay.identification import Identification
from bo_tuner.study.distributions import Discrete
from bo_tuner.study.study import Study

BINS = 40
PRIOR_DRAWS = 20_000
COLUMNS = 2


def context_figure(identified: Identification, narrower: Study) -> Figure:
    """Draw the density of each context before the runs and by them, and the bounds written."""
    space = identified.study.context_space()
    draws = space.draw_stratified(PRIOR_DRAWS, np.random.default_rng(0))
    panels = []
    for column, (name, variable) in enumerate(identified.study.contexts.items()):
        distribution = variable.distribution
        edges = np.linspace(distribution.lower, distribution.upper, BINS + 1)
        if isinstance(distribution, Discrete):
            middles = distribution.support[:-1] + 0.5 * np.diff(distribution.support)
            edges = np.array([middles[0] - 1.0, *middles, middles[-1] + 1.0])
        left = narrower.contexts[name].distribution
        panels.append(
            Panel(
                x=Axis(label=name, unit=variable.unit),
                y=Axis(label="probability"),
                elements=[
                    _shares(draws[:, column], edges, "before", Color.GRAY, Dash.DASHED),
                    _shares(
                        identified.posterior.contexts[:, column],
                        edges,
                        "by the runs",
                        Color.BLUE,
                        Dash.SOLID,
                    ),
                    Limit(value=left.lower, name="bounds written", vertical=True),
                    Limit(value=left.upper, vertical=True),
                ],
            )
        )
    return Figure(
        name="contexts",
        title="Where the machine is",
        caption="Share of each range of a context: before the runs, by the distribution of the box "
        "that was searched, and by the runs of the machine. The vertical lines are the bounds that "
        "were written.",
        alternative="The distribution of each context by the runs beside that before them.",
        panels=panels,
        columns=min(COLUMNS, len(panels)),
    )


def _shares(values: Array, edges: Array, name: str, color: Color, dash: Dash) -> Line:
    """Return the shares of values (m,) between edges (b + 1,) as steps."""
    shares = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0] / len(values)
    return Line(
        x=edges, y=np.append(shares, shares[-1]), name=name, color=color, dash=dash, step=True
    )
