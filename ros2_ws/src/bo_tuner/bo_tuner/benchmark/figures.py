"""The figures of a campaign, described for the renderers."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bo_tuner.benchmark.experiment import Case, Experiment
from bo_tuner.benchmark.statistics import exponent
from bo_tuner.benchmark.summary import Record, RowSummary, feasible_at
from bo_tuner.benchmark.tables import costs
from bo_tuner.figures.figure import (
    Axis,
    Band,
    Color,
    Dash,
    Figure,
    Limit,
    Line,
    Panel,
    Points,
    Scale,
)

COLORS = (Color.BLUE, Color.ORANGE, Color.GREEN, Color.PURPLE, Color.VERMILION, Color.SKY)
DASHES = (Dash.SOLID, Dash.DASHED, Dash.DOTTED, Dash.DASH_DOT)

STEPS = 120
"""Points of a line over the cuts."""


def convergence(case: Case, summaries: Sequence[RowSummary], optimum: float | None) -> Figure:
    """Quality of the best solution so far over the number of cuts (Fig. 4 of the paper)."""
    used = [s.cuts.value + s.check_cuts.value for s in summaries]
    cuts = np.linspace(0.0, max([case.cuts, *used]), STEPS)
    quality: list[Line | Band | Limit] = []
    shares: list[Line] = []
    many = len(summaries) > len(COLORS)
    for index, s in enumerate(summaries):
        # No two lines are alike, and a few differ in both.
        color = COLORS[index % len(COLORS)]
        dash = DASHES[(index // len(COLORS) if many else index) % len(DASHES)]
        found = [feasible_at(s.results, int(c)) for c in cuts]
        mean = np.array([np.mean(f) if f else np.nan for f in found])
        spread = np.array([np.std(f) if f else np.nan for f in found])
        # Many bands hide one another.
        if not many:
            quality.append(Band(x=cuts, lower=mean - spread, upper=mean + spread, color=color))
        quality.append(Line(x=cuts, y=mean, name=s.row.name, color=color, dash=dash))
        share = np.array([len(f) / case.runs for f in found])
        shares.append(Line(x=cuts, y=share, name=s.row.name, color=color, dash=dash))
    limits = None
    if optimum is not None:
        quality.append(Limit(value=optimum, name="optimum of the grid", color=Color.INK))
        limits = (0.97 * optimum, 1.6 * optimum)
    metric = case.study.metrics[case.study.objective.metric]
    return Figure(
        name=f"convergence-{case.name}",
        title=f"Best solution so far, {case.title}",
        caption=(
            "First: true objective of what a run believes to be its best feasible solution, mean "
            "and standard deviation over the runs where it is feasible in truth. Second: in what "
            "share of the runs it is."
        ),
        alternative="Lines that fall towards the optimum; the table beside it has the numbers.",
        panels=[
            Panel(
                x=Axis(label="cuts"),
                y=Axis(label=metric.name, unit=metric.unit or "", limits=limits),
                elements=quality,
            ),
            Panel(
                x=Axis(label="cuts"),
                y=Axis(label="runs truly feasible", limits=(0.0, 1.05)),
                elements=shares,
            ),
        ],
        # Side by side there is room for a long legend.
        columns=2 if many else 1,
    )


def calibration(experiment: Experiment, result: Record) -> tuple[Figure, str]:
    """Modelled against measured metric, and what the fit says."""
    given = experiment.calibration
    if given is None:
        raise ValueError("calibration: expected one in the experiment")
    whole = [
        (point["modelled"], point["measured"])
        for point in result["points"]
        if point["modelled"] is not None and None not in point["measured"]
    ]
    modelled = np.array([m for m, _ in whole])
    # The clock is disturbed upwards only, so the fastest repetition is the least disturbed.
    measured = np.array([min(values) for _, values in whole])
    slope, offset = np.polyfit(modelled, measured, 1)
    correlation = float(np.corrcoef(modelled, measured)[0, 1])
    unit = given.study.metrics[given.metric].unit or ""
    shown, scale = ("ms", 1e3) if unit == "s" else (unit, 1.0)
    text = (
        f"Measured = {offset:.3g} {unit} + {slope:.3g} × modelled, over {len(whole)} settings; "
        f"correlation {correlation:.3f}. The model stands for a computer whose steps take "
        f"{1.0 / slope:.1f} times as long as on this machine, beyond the constant part."
    )
    ends = np.array([modelled.min(), modelled.max()])
    figure = Figure(
        name="calibration",
        title=f"{given.key or given.metric}: modelled and measured",
        caption=(
            f"Each point is a cut with other horizons; measured: the lowest of {given.repeats} "
            "repetitions, the bar up to their median."
        ),
        alternative=f"Points along a straight line; correlation {correlation:.3f}.",
        panels=[
            Panel(
                x=Axis(label="modelled", unit=shown),
                y=Axis(label="measured", unit=shown),
                elements=[
                    Points(
                        x=scale * modelled,
                        y=scale * measured,
                        low=scale * measured,
                        high=[scale * float(np.median(values)) for _, values in whole],
                        name="cuts",
                    ),
                    Line(
                        x=scale * ends,
                        y=scale * (offset + slope * ends),
                        name="fit",
                        color=Color.VERMILION,
                    ),
                ],
            )
        ],
    )
    return figure, text


def cost_scaling(experiment: Experiment, done: Mapping[str, Record]) -> tuple[Figure, str]:
    """Cost of a run against trials and against the number of parameters, with fitted powers."""
    found = costs(experiment, done)
    given = experiment.cost
    if given is None:
        raise ValueError("cost: expected it in the experiment")
    smallest = min(given.dimensions)
    of_trials = {t: s for (d, t), s in found.items() if d == smallest}
    of_dimension = {d: s for (d, t), s in found.items() if t == given.compared_trials}
    first, said_first = _power_panel(of_trials, "trials", f"{smallest} parameters")
    second, said_second = _power_panel(
        of_dimension, "parameters", f"{given.compared_trials} trials"
    )
    figure = Figure(
        name="cost",
        title=f"Cost of a run of Algorithm {given.algorithm}, without its cuts",
        caption="Processor time of the optimizer on a study in closed form, each run a point.",
        alternative=f"Straight lines in logarithmic axes. {said_first} {said_second}",
        panels=[first, second],
        columns=2,
    )
    return figure, f"{said_first} {said_second}"


def _power_panel(
    seconds: Mapping[int, Sequence[float]], label: str, title: str
) -> tuple[Panel, str]:
    x = [float(k) for k, values in seconds.items() for _ in values]
    y = [value for values in seconds.values() for value in values]
    elements: list[Any] = [Points(x=x, y=y, name="runs")]
    text = ""
    if len(seconds) > 1:
        fit = exponent(x, y)
        ends = np.array([min(x), max(x)])
        elements.append(
            Line(
                x=ends,
                y=fit.factor * ends**fit.value,
                name=f"{label} to the power {fit.value:.2f}",
                color=Color.VERMILION,
            )
        )
        text = (
            f"With {title} the cost grows with the {label} to the power {fit.value:.2f} "
            f"({fit.low:.2f} to {fit.high:.2f})."
        )
    panel = Panel(
        title=title,
        x=Axis(label=label, scale=Scale.LOG, ticks=[(k, str(k)) for k in seconds]),
        y=Axis(label="processor time", unit="s", scale=Scale.LOG),
        elements=elements,
    )
    return panel, text
