"""The numbers of a certificate, row by row, and its table and lines in the terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rich.table import Table

from bo_tuner.evidence.certificate.context_tolerance import ContextTolerance, VariableTolerance
from bo_tuner.evidence.certificate.findings import widest
from bo_tuner.evidence.certificate.search_width import SearchWidth, widths_in_words
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.storage.json_numbers import to_number
from bo_tuner.study.constraint import CHANCE, SINGLE_RUN, WORST_CASE
from bo_tuner.study.study import Study
from bo_tuner.text import shown, shown_beside
from bo_tuner.trials import DEFAULT, TUNED, Value

Worst = Sequence[Mapping[str, Any]]
"""The contexts that a search has found for a constraint, the worst mean first."""
NOT_SEARCHED = "–"


@dataclass(frozen=True)
class Row:
    """A number of a certificate, in text.

    Attributes
    ----------
    label, unit
        What it is; indented if it tells more of the row above.
    values
        Its value for each parameter set.
    begins
        Whether it is the first one of a constraint, or of what all constraints have in common.
    """

    label: str
    unit: str
    values: tuple[str, ...]
    begins: bool = False


def parameter_sets(content: Mapping[str, Any]) -> list[str]:
    """Return the names of the parameter sets in the content of a certificate's file."""
    return [name for name in (DEFAULT, TUNED) if content[name] is not None]


def certificate_rows(study: Study, content: Mapping[str, Any]) -> list[Row]:
    """Return the numbers in the content of a certificate's file, each for all parameter sets."""
    sides = [content[name] for name in parameter_sets(content)]
    objective, tail = content["objective"], _tail(content)
    rows = [
        Row(
            f"mean {objective['metric']}",
            objective["unit"],
            tuple(_mean(side["objective"]) for side in sides),
            begins=True,
        ),
        Row(tail, objective["unit"], tuple(_number(side["tail"]) for side in sides)),
    ]
    level = f"{100.0 * float(content['bound_confidence']):.4g} % bound"
    for constraints in zip(*(side["constraints"] for side in sides), strict=True):
        rows += _of_constraint(study, constraints, level, tail)
    failed = tuple(f"{side['failures']} of {side['evaluations']}" for side in sides)
    verdicts = tuple(PASS if side["passed"] else FAIL for side in sides)
    return [*rows, Row("failed evaluations", "", failed, begins=True), Row("verdict", "", verdicts)]


def certificate_table(study: Study, content: Mapping[str, Any]) -> Table:
    """Return a table of the tuned parameter set, beside the default if that was evaluated."""
    names = parameter_sets(content)
    same = "the same " if len(names) > 1 else ""
    table = Table(
        title=f"{study.name}, trial {content['trial']}: {same}{content['drawn']} fresh draws",
        title_justify="left",
    )
    table.add_column("")
    table.add_column("unit")
    for name in names:
        table.add_column(name, justify="right")
    for name, item in study.parameters.items():
        values = [shown(content[side]["parameters"][name]) for side in names]
        table.add_row(name, item.unit, *values)
    for row in certificate_rows(study, content):
        if row.begins:
            table.add_section()
        table.add_row(row.label, row.unit, *row.values)
    return table


def certificate_lines(study: Study, content: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines on what the table leaves out: reasons, training and robustness."""
    for constraint in content[TUNED]["constraints"]:
        kept = "shown to hold" if constraint["passed"] else "NOT shown to hold"
        yield f"{constraint['name']}: {kept}: {constraint['reason']}"
        for assumption in constraint["assumptions"]:
            yield f"{constraint['name']}: with an assumption: {assumption}"
    runs, least = content[TUNED]["evaluations"], content[TUNED]["least"]
    yield f"{runs} runs; the fewest that show these limits are {least}"
    if searched := search_in_words(content):
        yield f"search for the worst context: {searched}"
    for gap in content["training_gaps"]:
        observed = "" if gap["observed"] is None else f"observed {_number(gap['observed'])}, "
        validated = f"{_number(gap['validated'])} {gap['unit']}".rstrip()
        yield (
            f"training and validation, {gap['name']}: {observed}predicted "
            f"{_number(gap['predicted'])}, validated {validated} (gap {gap_in_words(gap)})"
        )
    for tolerance in content["context_tolerances"]:
        yield from _context(study, ContextTolerance.from_mapping(tolerance))
    for warning in content["warnings"]:
        yield f"warning: {warning}"


def search_in_words(content: Mapping[str, Any]) -> str:
    """Return which violations the search for the worst context would have found; or nothing."""
    return widths_in_words(
        SearchWidth(float(item["probability"]), to_number(item["width"]))
        for item in content["search_widths"]
    )


def gap_in_words(gap: Mapping[str, Any]) -> str:
    """Return the gap between training and validation, with its standard error."""
    if gap["gap"] is None:
        return "–"
    error = gap["standard_error"]
    return f"{gap['gap']:+.2g}" + ("" if error is None else f" ± {error:.1g}")


def _of_constraint(
    study: Study, both: Sequence[Mapping[str, Any]], level: str, tail: str
) -> Iterator[Row]:
    tuned = both[-1]
    constraint = study.constraints[tuned["name"]]
    unit, limit, allowed = tuned["unit"], float(tuned["limit"]), float(tuned["allowed"])
    beyond = f"{constraint.beyond} {limit:g}"

    def row(label: str, unit: str, values: Iterator[str], *, begins: bool = False) -> Row:
        return Row(label, unit, tuple(values), begins)

    extreme = study.titled(constraint, f"{constraint.extreme} {constraint.metric}")
    yield row(extreme, unit, (_beside(c["extreme"], limit) for c in both), begins=True)
    yield row(tail, unit, (_number(c["tail"]) for c in both))
    yield row(f"  draws {beyond}", "", (str(c["violations"]) for c in both))
    violation = f"  P(violation), {level}"
    yield row(violation, "", (_beside(c["violation_bound"], allowed) for c in both))
    if constraint.kind == CHANCE:
        yield row("    allowed", "", (f"{c['allowed']:.4g}" for c in both))
    # There is no search for the worst context of a parameter set that the draws have refuted.
    if any(c["worst"] for c in both):

        def searched(show: Callable[[Worst], str]) -> Iterator[str]:
            return (show(c["worst"]) if c["worst"] else NOT_SEARCHED for c in both)

        title = study.titled(constraint, f"worst-case {constraint.limited}, mean")
        yield row(title, unit, searched(lambda worst: _mean(worst[0]["mean"], limit)))
        # Of all contexts that the search found: the worst one need not have the widest bound.
        side = constraint.side
        yield row(f"  {level}", unit, searched(lambda worst: _beside(_widest(side, worst), limit)))
        if constraint.statistic == SINGLE_RUN:
            yield row(violation, "", searched(lambda worst: _beside(_likeliest(worst), allowed)))
            yield row("    allowed", "", searched(lambda _: f"{tuned['allowed']:.4g}"))
        for name in study.contexts:
            yield row(f"  at {name}", "", searched(partial(_coordinate, name)))
        counts = searched(lambda worst: f"{worst[0]['beyond']} of {worst[0]['evaluations']}")
        yield row(f"  evaluations {beyond}", "", counts)
    yield row(
        f"  {'kept in every context' if constraint.kind == WORST_CASE else 'kept'}",
        "",
        ("shown" if c["passed"] else "NOT shown" for c in both),
    )


def _widest(side: str, worst: Worst) -> float | None:
    """Return the bound of the mean that decides; None for an infinite one, as JSON has it."""
    bounds = [context["mean"][side] for context in worst]
    return None if None in bounds else widest(side, bounds)


def _likeliest(worst: Worst) -> float:
    return max(to_number(context["violation_bound"]) for context in worst)


def _coordinate(name: str, worst: Worst) -> str:
    value: Value = worst[0]["context"][name]
    return shown(value) if isinstance(value, (bool, str)) else _number(value)


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
    alone = f"from {variable.down.in_words} to {variable.up.in_words}"
    worst = f"from {variable.worst_down.in_words} to {variable.worst_up.in_words}"
    return f"may drift {alone}{unit} alone, {worst}{unit} with all others as in the worst context"


def _number(value: float | None) -> str:
    return shown(to_number(value))


def _beside(value: float | None, limit: float) -> str:
    return shown_beside(to_number(value), limit)


def _mean(mean: Mapping[str, float | None], limit: float | None = None) -> str:
    value = to_number(mean["value"])
    found = shown(value) if limit is None else shown_beside(value, limit)
    error = mean["standard_error"]
    return found if error is None else f"{found} ± {error:.2g}"


def _tail(content: Mapping[str, Any]) -> str:
    return f"  CVaR, worst {100.0 * (1.0 - float(content['tail_level'])):.3g} %"
