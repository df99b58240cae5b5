"""How far the machine may drift before a limit breaks, from all evaluations of the answer."""

import numpy as np

from bo_tuner.certificate.context_tolerance import (
    CREDIBLE,
    ContextTolerance,
    Drift,
    context_tolerance,
)
from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number, quantity, values


def drift(analysis: Analysis) -> Section | None:
    """Show which context variable hurts most; None without a worst case or enough evaluations."""
    answer = analysis.answer
    if answer is None:
        return None
    found = context_tolerance(analysis.study, analysis.evaluations_of(answer.parameters))
    if found is None:
        return None
    first = found.variables[0]
    percent = f"{100.0 * CREDIBLE:g} %"
    return Section(
        name="drift",
        title="How far the machine may drift",
        lead=f"{first.name} hurts {found.metric} most: at its nominal value the worst case would "
        f"be lower by {quantity(first.relief.median, found.unit)} "
        f"({number(first.relief.low)} to {number(first.relief.high)}).",
        figures=[_reliefs(found)],
        tables=[
            Table(
                caption=f"Tolerated ranges, with {percent} credible bands where a limit breaks "
                "within the range of the study",
                header=["", "unit", "nominal", "alone", "all others at their worst"],
                rows=[
                    [
                        v.name,
                        v.unit,
                        number(v.nominal),
                        f"{_end(v.down)} to {_end(v.up)}",
                        f"{_end(v.worst_down)} to {_end(v.worst_up)}",
                    ]
                    for v in found.variables
                ],
                numeric=[2],
            )
        ],
        notes=[
            f"From {found.evaluations} runs with the tuned parameters. The mean {found.metric} "
            f"over noise is {quantity(found.nominal.median, found.unit)} in the nominal context "
            f"and {quantity(found.worst.median, found.unit)} ({number(found.worst.low)} to "
            f"{number(found.worst.high)}) in the worst one ({values(found.worst_context)}); the "
            f"limit is {quantity(found.limit, found.unit)}. Nothing is said beyond the ranges of "
            "the study."
        ],
    )


def _reliefs(found: ContextTolerance) -> Figure:
    reliefs = [variable.relief for variable in found.variables]
    places = np.arange(len(reliefs), dtype=float)
    names = [variable.name for variable in found.variables]
    said = [f"{n}: {quantity(r.median, found.unit)}" for n, r in zip(names, reliefs, strict=True)]
    return Figure(
        name="drift",
        title=f"What each context variable does to the worst {found.metric}",
        caption=f"How much the worst case falls if this variable alone is put back to its nominal "
        f"value, with the {100.0 * CREDIBLE:g} % credible band.",
        alternative="; ".join(said),
        panels=[
            Panel(
                x=Axis(label="", ticks=list(zip(places.tolist(), names, strict=True))),
                y=Axis(label="relief", unit=found.unit),
                elements=[
                    Bars(
                        x=places,
                        y=[relief.median for relief in reliefs],
                        low=[relief.low for relief in reliefs],
                        high=[relief.high for relief in reliefs],
                        color=Color.SKY,
                        width=0.4,
                        base=np.zeros(len(reliefs)),
                        hover=said,
                    )
                ],
            )
        ],
        panel_height=240,
    )


def _end(end: Drift) -> str:
    """Value that is tolerated; its band where the limit breaks on the way to the bound."""
    if end.breaks <= 0.5 * (1.0 - CREDIBLE):
        return f"{number(end.bound)} (end of the range)"
    return f"{number(end.limit.median)} ({number(end.limit.low)} to {number(end.limit.high)})"
