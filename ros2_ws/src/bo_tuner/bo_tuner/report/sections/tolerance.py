"""Tolerance to the context: how far each variable may drift before the limit is exceeded."""

import numpy as np

from bo_tuner.evidence.certificate.context_tolerance import (
    CREDIBLE,
    ContextTolerance,
    context_tolerances,
)
from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number, numbered, quantity
from bo_tuner.study.study import Study
from bo_tuner.text import values


def tolerance(analysis: Analysis) -> Section | None:
    """Show the effect of each context variable; None without a worst case or enough data."""
    answer = analysis.answer
    if answer is None:
        return None
    certificate, study = analysis.certificate, analysis.study
    if certificate is not None and certificate.is_of(answer):
        tolerances = certificate.context_tolerances
    else:
        tolerances = context_tolerances(study, analysis.evaluations_of(answer.parameters))
    if not tolerances:
        return None
    limited = [_limited(study, found) for found in tolerances]
    return Section(
        name="tolerance",
        title="How far each context variable may drift",
        lead=" ".join(map(_lead, tolerances, limited)),
        figures=[
            _reliefs(found, name, numbered("tolerance", k))
            for k, (found, name) in enumerate(zip(tolerances, limited, strict=True))
        ],
        tables=[_table(found) for found in tolerances],
        notes=[
            *(_note(found, analysis.answer_set) for found in tolerances),
            "There are no predictions outside the ranges of the study.",
        ],
    )


def _limited(study: Study, found: ContextTolerance) -> str:
    constraint = study.constraints[found.constraint]
    return study.titled(constraint, constraint.limited)


def _lead(found: ContextTolerance, limited: str) -> str:
    first = found.variables[0]
    return (
        f"{limited} is most sensitive to {first.name}: at its nominal value the worst "
        f"case would be {found.relieved} by {quantity(first.relief.median, found.unit)} "
        f"({number(first.relief.low)} to {number(first.relief.high)})."
    )


def _table(found: ContextTolerance) -> Table:
    return Table(
        caption=f"Tolerated ranges, with {100.0 * CREDIBLE:g} % credible bands where the limit "
        f"{found.constraint} is violated within the range of the study",
        header=["", "unit", "nominal", "alone", "others as in the worst context"],
        rows=[
            [
                v.name,
                v.unit,
                number(v.nominal),
                f"{v.down.in_words} to {v.up.in_words}",
                f"{v.worst_down.in_words} to {v.worst_up.in_words}",
            ]
            for v in found.variables
        ],
        numeric=[2],
    )


def _note(found: ContextTolerance, subject: str) -> str:
    return (
        f"From {found.evaluations} evaluations of the {subject}. The mean "
        f"{found.metric} over noise is {quantity(found.nominal.median, found.unit)} in the "
        f"nominal context and {quantity(found.worst.median, found.unit)} "
        f"({number(found.worst.low)} to {number(found.worst.high)}) in the worst one "
        f"({values(found.worst_context)}); the limit is {quantity(found.limit, found.unit)}."
    )


def _reliefs(found: ContextTolerance, limited: str, name: str) -> Figure:
    reliefs = [variable.relief for variable in found.variables]
    places = np.arange(len(reliefs), dtype=float)
    names = [variable.name for variable in found.variables]
    texts = [f"{n}: {quantity(r.median, found.unit)}" for n, r in zip(names, reliefs, strict=True)]
    return Figure(
        name=name,
        title=f"Effect of each context variable on the worst {limited}",
        caption="Distance by which the worst case moves away from the limit when this variable "
        f"alone returns to its nominal value, with the {100.0 * CREDIBLE:g} % credible band.",
        alternative="; ".join(texts),
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
                        hover=texts,
                    )
                ],
            )
        ],
        panel_height=240,
    )
