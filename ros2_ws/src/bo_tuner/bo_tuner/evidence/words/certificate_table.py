"""The numbers of a certificate, row by row, and what the terminal says of it below the verdict."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, isnan, nan

from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.claim import failed_before, seen
from bo_tuner.evidence.certificate.findings import (
    TAIL,
    ConstraintVerdict,
    WorstContext,
    widest,
)
from bo_tuner.evidence.certificate.risk import Mean
from bo_tuner.evidence.verdict import FAIL, PASS, Verdict
from bo_tuner.evidence.words.certificate import warnings
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.evidence.words.quantities import basis, gain
from bo_tuner.evidence.words.reasons import proven, reason
from bo_tuner.evidence.words.verdict import of_default
from bo_tuner.study.study import Study
from bo_tuner.text import shown, shown_beside

Worst = Sequence[WorstContext]
"""The contexts that a search has found for a constraint, the worst mean first."""
NOT_SEARCHED = "–"
CVAR = f"  CVaR, worst {100.0 * (1.0 - TAIL):.3g} %"


@dataclass(frozen=True)
class Row:
    """A number of a certificate, in text.

    Attributes
    ----------
    label, unit
        What it is; indented if it is a detail of the row above.
    values
        Its value for each parameter set.
    """

    label: str
    unit: str
    values: tuple[str, ...]


def certificate_rows(study: Study, certificate: Certificate) -> list[Row]:
    """Return the numbers of a certificate, each for all of its parameter sets."""
    sides = [*certificate.sides.values()]
    objective = certificate.objective
    # Its mean stands with the verdict, which compares it with that of the default.
    cvar = f"{study.metrics[objective.metric].title}, {CVAR.strip()}"
    rows = [Row(cvar, objective.unit, tuple(shown(side.tail) for side in sides))]
    level = f"{100.0 * certificate.bound_confidence:.4g} % bound"
    for constraints in zip(*(side.constraints for side in sides), strict=True):
        rows += _of_constraint(study, constraints, level)
    failed = tuple(f"{side.failures} of {side.evaluations}" for side in sides)
    verdicts = tuple(PASS if side.passed else FAIL for side in sides)
    return [*rows, Row("failed test runs", "", failed), Row("verdict", "", verdicts)]


def certificate_lines(
    verdict: Verdict, study: Study, certificate: Certificate, most: int
) -> list[str]:
    """Return what a terminal says of a certificate: of each limit, and what speaks against it."""
    others = [*map(in_words, failed_before(study, certificate))][:1]
    others += [f"{gain(q)}; {basis(q)}" for q in verdict.quantities if q.objective][:1]
    others += [of_default(verdict)] if certificate.default is not None else []
    others += [f"warning: {warning}" for warning in warnings(study, certificate)][:1]
    others += map(in_words, seen(study, certificate.seen))
    limits = sorted(certificate.tuned.constraints, key=lambda item: item.passed)
    titles = {name: study.limit_title(item) for name, item in study.constraints.items()}
    lines = [f"{titles[item.name]}: {proven(item)}: {reason(item)}" for item in limits]
    if certificate.tuned.failures:
        lines.insert(0, f"{certificate.tuned.failures} of {certificate.tuned.evaluations} failed")
    room = most - len(others)
    if len(lines) > room:
        lines = [*lines[: room - 1], f"{len(lines) - room + 1} more are in the report"]
    return [*lines, *others]


def _of_constraint(study: Study, both: Sequence[ConstraintVerdict], level: str) -> Iterator[Row]:
    tuned = both[-1]
    constraint = study.constraints[tuned.name]
    unit, limit, allowed = tuned.unit, tuned.limit, tuned.allowed
    beyond = f"{constraint.beyond} {limit:g}"

    def row(label: str, unit: str, values: Iterator[str]) -> Row:
        return Row(label, unit, tuple(values))

    extreme = study.titled(
        constraint, f"{constraint.extreme} {study.metrics[constraint.metric].title}"
    )
    yield row(extreme, unit, (shown_beside(c.extreme, limit) for c in both))
    yield row(CVAR, unit, (shown(c.tail) for c in both))
    yield row(f"  test runs {beyond}", "", (str(c.violations) for c in both))
    violation = f"  P(violation), {level}"
    yield row(violation, "", (shown_beside(c.violation_bound, allowed) for c in both))
    if constraint.rule.on_runs and not constraint.rule.in_every_context:
        yield row("    allowed", "", (f"{c.allowed:.4g}" for c in both))
    # There is no search for the worst context of a parameter set that the draws have refuted.
    if any(c.worst for c in both):

        def searched(show: Callable[[Worst], str]) -> Iterator[str]:
            return (show(c.worst) if c.worst else NOT_SEARCHED for c in both)

        title = study.titled(constraint, f"worst-case {study.limited(constraint)}, mean")
        yield row(title, unit, searched(lambda worst: _mean(worst[0].mean, limit)))
        # Of all contexts that the search found: the worst one need not have the widest bound.
        side = constraint.side
        yield row(
            f"  {level}", unit, searched(lambda worst: shown_beside(_widest(side, worst), limit))
        )
        if constraint.rule.on_runs:
            yield row(
                violation, "", searched(lambda worst: shown_beside(_likeliest(worst), allowed))
            )
            yield row("    allowed", "", searched(lambda _: f"{allowed:.4g}"))
        for name in study.contexts:
            yield row(f"  at {name}", "", searched(partial(_coordinate, name)))
        counts = searched(lambda worst: f"{worst[0].beyond} of {worst[0].evaluations}")
        yield row(f"  test runs there {beyond}", "", counts)
    yield row(
        f"  {'kept in every context' if constraint.rule.in_every_context else 'kept'}",
        "",
        (proven(c).partition(",")[0] for c in both),
    )


def _widest(side: str, worst: Worst) -> float:
    """Return the bound of the mean that decides; NaN if too few runs bound it."""
    bound = widest(side, (context.mean.bound(side) for context in worst))
    return bound if isfinite(bound) else nan


def _likeliest(worst: Worst) -> float:
    return max(context.violation_bound for context in worst)


def _coordinate(name: str, worst: Worst) -> str:
    return shown(worst[0].context[name])


def _mean(mean: Mean, limit: float) -> str:
    value = shown_beside(mean.value, limit)
    error = mean.standard_error
    return value if isnan(error) else f"{value} ± {error:.2g}"
