"""Tolerance to the context: how far each variable may drift before the limit is exceeded."""

from bo_tuner.evidence.certificate.context_tolerance import (
    CREDIBLE,
    ContextTolerance,
    context_tolerances,
)
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.content import Section, Table, number, quantity
from bo_tuner.study.study import Study
from bo_tuner.text import counted, values


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
    limited = [_limited(study, item) for item in tolerances]
    return Section(
        name="tolerance",
        title="How far may the machine drift?",
        lead=" ".join(map(_lead, tolerances, limited)),
        tables=[_table(item) for item in tolerances],
        notes=[
            *(_note(item, analysis.answer_set) for item in tolerances),
            "* End of the range of the study; nothing is predicted beyond.",
        ],
    )


def _limited(study: Study, item: ContextTolerance) -> str:
    constraint = study.constraints[item.constraint]
    return study.limit_title(constraint)


def _lead(item: ContextTolerance, limited: str) -> str:
    first = item.variables[0]
    return (
        f"{limited} is most sensitive to {first.name}: at its nominal value the worst "
        f"case would be {item.relieved} by {quantity(first.relief.median, item.unit)} "
        f"({number(first.relief.low)} to {number(first.relief.high)})."
    )


def _table(item: ContextTolerance) -> Table:
    return Table(
        caption=f"Tolerated ranges, with {100.0 * CREDIBLE:g} % credible bands",
        header=["", "unit", "nominal", "alone", "others as in the worst context"],
        rows=[
            [
                v.name,
                v.unit,
                number(v.nominal),
                f"{v.down.in_words} to {v.up.in_words}",
                f"{v.worst_down.in_words} to {v.worst_up.in_words}",
            ]
            for v in item.variables
        ],
        numeric=[2],
    )


def _note(item: ContextTolerance, subject: str) -> str:
    return (
        f"From {counted(item.evaluations, 'test run')} of the {subject}: mean "
        f"{quantity(item.nominal.median, item.unit)} in the nominal context, "
        f"{quantity(item.worst.median, item.unit)} at {values(item.worst_context)}; limit "
        f"{quantity(item.limit, item.unit)}."
    )
