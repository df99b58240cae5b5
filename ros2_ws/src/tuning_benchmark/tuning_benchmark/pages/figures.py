"""The figures of a campaign, described for the renderers."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from bo_tuner.figures.figure import (
    Axis,
    Band,
    Color,
    Dash,
    Element,
    Figure,
    Line,
    Panel,
    Points,
    Scale,
)
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.parts import LOG
from tuning_benchmark.experiments.experiment import Calibration, Case, Cost
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, Effort
from tuning_benchmark.pages.statistics import Mean, Power, mean, power
from tuning_benchmark.pages.summary import Record, RowSummary, feasible_at
from tuning_benchmark.pages.tables import costs

COLORS = (Color.BLUE, Color.ORANGE, Color.GREEN, Color.PURPLE, Color.VERMILION)
"""Of the rows; more than these cannot be kept apart in one panel."""
DASHES = (Dash.SOLID, Dash.DASHED, Dash.DOTTED, Dash.DASH_DOT, Dash.DASHED)

STEPS = 120
"""Points of a line over the evaluations."""

QUARTILES = (25, 50, 75)

HEADROOM = 1.15
SETTLED = 0.25
"""Part of the budget after which a line must fit into its panel; before, incumbents are poor."""


def convergence(case: Case, summaries: Sequence[RowSummary], optimum: float | None) -> Figure:
    """Quality of the incumbent over the number of evaluations (Fig. 4 of the paper)."""
    evaluations = np.linspace(
        0.0, max([case.evaluations, *(s.most_evaluations for s in summaries)]), STEPS
    )
    values_of_rows = [
        [feasible_at(s.results.values(), int(count)) for count in evaluations] for s in summaries
    ]
    metric = case.study.metrics[case.study.objective.metric]
    label, unit = f"median {metric.name}", metric.unit or ""
    sign = case.study.objective.sign
    if optimum is not None:
        # From zero on, no difference looks larger than it is.
        label, unit = "median above the optimum", "%"
        values_of_rows = [
            [[100.0 * sign * (value / optimum - 1.0) for value in values] for values in row]
            for row in values_of_rows
        ]
    medians = [_medians(row) for row in values_of_rows]
    y = Axis(label=label, unit=unit, limits=_limits(medians, case.study.objective.scale == LOG))
    x = Axis(label="evaluations", limits=(0.0, float(evaluations[-1])))
    shares = [np.array([len(values) / case.runs for values in row]) for row in values_of_rows]
    return Figure(
        name=f"convergence-{case.name}",
        title=f"Incumbents, {case.title}",
        caption=(
            "Left: median and quartiles of the true objective of the incumbent, the solution that "
            "a run predicts to be its best feasible one, over the runs where it is truly feasible. "
            "Right: share of the runs whose incumbent is truly feasible. What lies beyond the axis "
            "is poorer. The truth is over "
            f"{Effort().drawn} drawn contexts, not over 25 test runs as in the paper; the chance "
            f"constraints of incumbents are judged by {FEW_REAL_EVALUATIONS} evaluations on the "
            f"real objects, those of answers by {Effort().real_evaluations}."
        ),
        alternative="Lines that fall towards the optimum; the table below has the numbers.",
        panels=_panels(summaries, evaluations, medians, shares, x, y),
        columns=2,
        panel_height=320,
    )


def _panels(
    summaries: Sequence[RowSummary],
    evaluations: Array,
    medians: Sequence[Array],
    shares: Sequence[Array],
    x: Axis,
    y: Axis,
) -> list[Panel]:
    """Draw the rows in one panel, and the shares of feasible incumbents in another."""
    quality: list[Element] = []
    feasible: list[Element] = []
    for s, (low, middle, high), share, color, dash in zip(
        summaries, medians, shares, COLORS, DASHES, strict=False
    ):
        quality.append(Band(x=evaluations, lower=low, upper=high, color=color))
        quality.append(Line(x=evaluations, y=middle, name=s.row.name, color=color, dash=dash))
        feasible.append(Line(x=evaluations, y=share, name=s.row.name, color=color, dash=dash))
    return [
        Panel(x=x, y=y, elements=quality),
        Panel(x=x, y=Axis(label="runs truly feasible", limits=(0.0, 1.05)), elements=feasible),
    ]


def _limits(medians: Sequence[Array], logarithmic: bool) -> tuple[float, float] | None:
    """Return an axis from zero to the largest median once runs have settled; None without any.

    Values of either sign, such as those of an objective to maximize, have an axis of their own.
    """
    settled = np.concatenate([middle[int(SETTLED * STEPS) :] for _, middle, _ in medians])
    settled = settled[np.isfinite(settled)]
    if len(settled) == 0 or (settled.min() < 0.0 and not logarithmic):
        return None
    return min(0.0, HEADROOM * float(settled.min())), HEADROOM * max(float(settled.max()), 1e-9)


def _medians(moments: Sequence[Sequence[float]]) -> Array:
    """First quartile, median and third quartile (3, moments); NaN without values."""
    empty = [np.nan] * len(QUARTILES)
    return np.array([np.percentile(f, QUARTILES) if f else empty for f in moments]).T


def calibration(given: Calibration, result: Record) -> tuple[Figure | None, str]:
    """Modelled against measured metric, and the line that calibrates the one to the other.

    Without two settings that have both there is no line, and no figure.
    """
    whole = [
        (point["modelled"], point["measured"])
        for point in result["points"]
        if point["modelled"] is not None and None not in point["measured"]
    ]
    shown_key = given.key or given.metric
    if len({m for m, _ in whole}) < 2:
        return None, (
            f"No line: {len(whole)} of {len(result['points'])} settings have a modelled and a "
            f"measured {shown_key}, and a line needs two that differ."
        )
    modelled = np.array([m for m, _ in whole])
    # The clock is disturbed upwards only, so the fastest repetition is the least disturbed.
    measured = np.array([min(values) for _, values in whole])
    slope, offset = np.polyfit(modelled, measured, 1)
    correlation = float(np.corrcoef(modelled, measured)[0, 1])
    unit = given.study.metrics[given.metric].unit or ""
    shown, scale = ("ms", 1e3) if unit == "s" else (unit, 1.0)
    text = (
        f"Measured = {offset:.3g} {unit} + {slope:.3g} × modelled, over {len(whole)} settings; "
        f"correlation {correlation:.3f}. This line calibrates the model to this machine. The "
        f"model's own constants are settings of the study; they describe a computer whose steps "
        f"take {1.0 / slope:.1f} times as long, apart from the constant part."
    )
    ends = np.array([modelled.min(), modelled.max()])
    figure = Figure(
        name="calibration",
        title=f"{shown_key}: modelled and measured",
        caption=(
            f"Each point is one setting of the horizons; measured: the lowest of {given.repeats} "
            f"repetitions, with a bar up to their median.{_other_key(given)}"
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
                        name="evaluations",
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


def _other_key(given: Calibration) -> str:
    """Mention if the study limits another key than the one compared here."""
    metric = given.study.metrics[given.metric]
    limited = metric.key if isinstance(metric, ReportedMetric) else metric.name
    if given.key in ("", limited):
        return ""
    return f" The comparison is by {given.key}, which is less noisy; the study limits {limited}."


def cost_scaling(given: Cost, done: Mapping[str, Record]) -> tuple[Figure, str]:
    """Cost of a run against trials and against the number of parameters, with fitted powers."""
    seconds_by_size = costs(given, done)
    smallest = min(given.dimensions)
    of_trials = {t: s for (d, t), s in seconds_by_size.items() if d == smallest}
    of_dimension = {d: s for (d, t), s in seconds_by_size.items() if t == given.compared_trials}
    first, said_first = _power_panel(of_trials, "trials", f"{smallest} parameters")
    second, said_second = _power_panel(
        of_dimension, "parameters", f"{given.compared_trials} trials"
    )
    text = f"{said_first} {said_second} The lines in the figure are fits.".strip()
    figure = Figure(
        name="cost",
        title=f"Cost of a run of Algorithm {given.algorithm}, without its evaluations",
        caption="Processor time of the optimizer on a study in closed form, each run a point.",
        alternative=f"Straight lines in logarithmic axes. {text}",
        panels=[first, second],
        columns=2,
    )
    return figure, text


def _power_panel(
    seconds: Mapping[int, Mapping[int, float]], label: str, title: str
) -> tuple[Panel, str]:
    """Draw seconds by number and seed, with the power law of a run, and describe its exponent."""
    points = [(float(k), value) for k, runs in seconds.items() for value in runs.values()]
    elements: list[Element] = [
        Points(x=[x for x, _ in points], y=[y for _, y in points], name="runs")
    ]
    text = ""
    fits = _fits(seconds)
    if fits:
        exponent = mean([fit.exponent for fit in fits])
        # The lines of all runs have this mean, in logarithmic axes.
        factor = float(np.exp(np.mean([np.log(fit.factor) for fit in fits])))
        ends = np.array([float(min(seconds)), float(max(seconds))])
        elements.append(
            Line(
                x=ends,
                y=factor * ends**exponent.value,
                name=f"{label} to the power {exponent.value:.2f}",
                color=Color.VERMILION,
            )
        )
        text = (
            f"With {title} the cost grows with the {label} to the power {_exponent(exponent)}"
            f"{_local_exponents(seconds)}."
        )
    panel = Panel(
        title=title,
        x=Axis(label=label, scale=Scale.LOG, ticks=[(k, str(k)) for k in seconds]),
        y=Axis(label="processor time", unit="s", scale=Scale.LOG),
        elements=elements,
    )
    return panel, text


def _fits(seconds: Mapping[int, Mapping[int, float]]) -> list[Power]:
    """Fit a power law to each run: the times of one run are no independent observations."""
    fits = []
    for seed in sorted({seed for runs in seconds.values() for seed in runs}):
        run = {x: runs[seed] for x, runs in seconds.items() if seed in runs}
        if len(run) > 1:
            fits.append(power(list(run), list(run.values())))
    return fits


def _exponent(exponent: Mean) -> str:
    if exponent.count == 1:
        return f"{exponent.value:.2f} (one run)"
    return (
        f"{exponent.value:.2f} ({exponent.low:.2f} to {exponent.high:.2f}, {exponent.count} seeds)"
    )


def _local_exponents(seconds: Mapping[int, Mapping[int, float]]) -> str:
    """List the exponents between neighbouring numbers; nothing if there is only one."""
    local = []
    for a, b in pairwise(sorted(seconds)):
        fits = _fits({a: seconds[a], b: seconds[b]})
        if fits:
            exponent = np.mean([fit.exponent for fit in fits])
            local.append(f"{exponent:.2f} from {a} to {b}")
    return f"; {', '.join(local)}" if len(local) > 1 else ""
