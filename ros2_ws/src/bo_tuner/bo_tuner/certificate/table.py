"""A certificate as a table in the terminal."""

import math
from collections.abc import Iterator, Sequence

from rich.table import Table

from bo_tuner.certificate.certificate import Certificate
from bo_tuner.certificate.context_tolerance import (
    CREDIBLE,
    ContextTolerance,
    Drift,
    VariableTolerance,
)
from bo_tuner.certificate.evidence import (
    TAIL,
    ConstraintVerdict,
    Findings,
    WorstContext,
    widest,
)
from bo_tuner.certificate.risk import Mean
from bo_tuner.study.parts import CHANCE, SINGLE_RUN, UPPER
from bo_tuner.study.study import Study
from bo_tuner.text import shown


def certificate_table(certificate: Certificate) -> Table:
    """Return a table of the tuned parameter set, beside the default if that was evaluated."""
    study = certificate.study
    default = certificate.default
    both = (certificate.tuned,) if default is None else (default, certificate.tuned)
    same = "" if default is None else "the same "
    table = Table(
        title=f"{study.name}, trial {certificate.trial}: {same}{certificate.drawn} fresh draws",
        title_justify="left",
    )
    table.add_column("")
    table.add_column("unit")
    for name in ("tuned",) if default is None else ("default", "tuned"):
        table.add_column(name, justify="right")
    for name, item in study.parameters.items():
        table.add_row(name, item.unit, *[shown(f.parameters[name]) for f in both])
    table.add_section()
    metric = study.metrics[study.objective.metric]
    table.add_row(f"mean {metric.name}", metric.unit, *[_mean(f.objective) for f in both])
    table.add_row(_tail(), metric.unit, *[f"{f.tail:.4g}" for f in both])
    level = certificate.bound_confidence
    for constraints in zip(*[f.constraints for f in both], strict=True):
        table.add_section()
        for row in _constraint_rows(study, constraints, level):
            table.add_row(*row)
    table.add_section()
    table.add_row("failed evaluations", "", *[f"{f.failures} of {f.evaluations}" for f in both])
    table.add_row("verdict", "", *[_verdict(f) for f in both])
    return table


def certificate_lines(certificate: Certificate) -> Iterator[str]:
    """Yield lines on what the table leaves out: reasons, training and robustness."""
    for constraint in certificate.tuned.constraints:
        shown = "shown to hold" if constraint.passed else "NOT shown to hold"
        yield f"{constraint.name}: {shown}: {constraint.reason}"
    for gap in certificate.gaps:
        unit = f" {gap.unit}" if gap.unit else ""
        observed = "" if math.isnan(gap.observed) else f"observed {gap.observed:.4g}, "
        yield (
            f"training and validation, {gap.name}: {observed}predicted {gap.predicted:.4g}, "
            f"validated {gap.validated:.4g}{unit} "
            f"(gap {gap.value:+.2g} ± {gap.standard_error:.1g})"
        )
    for tolerance in certificate.tolerances:
        yield from _context(certificate.study, tolerance)
    for warning in certificate.warnings:
        yield f"warning: {warning}"


def _constraint_rows(
    study: Study, both: Sequence[ConstraintVerdict], confidence: float
) -> Iterator[list[str]]:
    tuned = both[-1]
    constraint = study.constraints[tuned.name]
    metric, unit = tuned.metric, tuned.unit
    bound = f"{100.0 * confidence:.4g} % bound"
    upper = tuned.side == UPPER
    beyond = f"{'above' if upper else 'below'} {tuned.limit:g}"
    extreme = study.titled(constraint, f"{constraint.extreme} {metric}")
    yield [extreme, unit, *[f"{c.extreme:.4g}" for c in both]]
    yield [_tail(), unit, *[f"{c.tail:.4g}" for c in both]]
    yield [f"  draws {beyond}", "", *[str(c.violations) for c in both]]
    yield [f"  P(violation), {bound}", "", *[f"{c.violation_bound:.4f}" for c in both]]
    if tuned.kind == CHANCE:
        yield ["    allowed", "", *[f"{c.allowed:.4g}" for c in both]]
    if all(c.worst for c in both):
        worst = [c.worst[0] for c in both]
        title = study.titled(constraint, f"worst-case {constraint.limited}, mean")
        yield [title, unit, *[_mean(w.mean) for w in worst]]
        # Of all contexts that the search found: the worst one need not have the widest bound.
        means = [[w.mean.upper if upper else w.mean.lower for w in c.worst] for c in both]
        bounds = [widest(tuned.side, values) for values in means]
        yield [f"  {bound}", unit, *[f"{b:.4g}" if math.isfinite(b) else "–" for b in bounds]]
        if tuned.statistic == SINGLE_RUN:
            there = [max(w.violation_bound for w in c.worst) for c in both]
            yield [f"  P(violation), {bound}", "", *[f"{value:.4f}" for value in there]]
            yield ["    allowed", "", *[f"{c.allowed:.4g}" for c in both]]
        for k, name in enumerate(tuned.worst[0].context):
            yield [f"  at {name}", "", *[f"{list(w.context.values())[k]:.4g}" for w in worst]]
        yield [f"  evaluations {beyond}", "", *[_beyond(w) for w in worst]]


def _context(study: Study, tolerance: ContextTolerance) -> Iterator[str]:
    first = tolerance.variables[0]
    unit = f" {tolerance.unit}" if tolerance.unit else ""
    constraint = study.constraints[tolerance.constraint]
    yield (
        f"{study.titled(constraint, constraint.limited)} is most sensitive to {first.name}: "
        f"at its nominal value the worst case would be {tolerance.relieved} by "
        f"{first.relief.median:.2g}{unit} ({first.relief.low:.2g} to {first.relief.high:.2g})"
    )
    for variable in tolerance.variables:
        yield f"{variable.name}: {_tolerated(variable)}"


def _tolerated(variable: VariableTolerance) -> str:
    unit = f" {variable.unit}" if variable.unit else ""
    alone = f"from {_end(variable.down)} to {_end(variable.up)}"
    worst = f"from {_end(variable.worst_down)} to {_end(variable.worst_up)}"
    return f"may drift {alone}{unit} alone, {worst}{unit} with all others as in the worst context"


def _end(drift: Drift) -> str:
    """Return the last tolerated value, with its band if the limit is crossed before the bound."""
    if drift.breaks <= 0.5 * (1.0 - CREDIBLE):
        return f"{drift.bound:.4g} (end of the range)"
    return f"{drift.limit.median:.4g} ({drift.limit.low:.4g} to {drift.limit.high:.4g})"


def _mean(mean: Mean) -> str:
    return f"{mean.value:.4g} ± {mean.standard_error:.2g}"


def _beyond(worst: WorstContext) -> str:
    return f"{worst.beyond} of {worst.evaluations}"


def _tail() -> str:
    return f"  CVaR, worst {100.0 * (1.0 - TAIL):.3g} %"


def _verdict(findings: Findings) -> str:
    return "PASS" if findings.passed else "FAIL"
