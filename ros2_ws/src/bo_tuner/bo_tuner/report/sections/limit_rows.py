"""The table of the first screen: objectives, limits with a bar against each, and what changed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.facts import ClaimedLimit
from bo_tuner.evidence.gains import gains
from bo_tuner.evidence.infeasible import Infeasible
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.verdict import State, Status, Verdict
from bo_tuner.study.limits import Standing
from bo_tuner.text import counted, shown_beside, with_unit

PLACE = 0.8
"""Where on a bar its limit stands, unless a value is too far beyond."""


@dataclass(frozen=True)
class Bar:
    """A value against its limit, all as shares of the bar."""

    default: float
    tuned: float
    limit: float


@dataclass(frozen=True)
class Row:
    """A number in words: its title, of what it is, the two values, the change, and the limit.

    Attributes
    ----------
    title, detail
        What it is, and of what: the objective, or how often a limit must be kept.
    default, tuned, change
        The values, and what has become of them.
    bar, limit
        Against the limit; None and empty without one, or where no bar can show it.
    shown, status, runs
        What is found of the limit, how good that is, and runs over and permitted.
    """

    title: str
    detail: str
    default: str
    tuned: str
    change: str
    bar: Bar | None = None
    limit: str = ""
    shown: str = ""
    status: Status = Status.OPEN
    runs: str = ""


def rows(verdict: Verdict) -> Iterator[Row]:
    """Yield the rows: objectives, limits, then other metrics that have changed."""
    means = {q.metric: q for q in verdict.quantities if q.estimates is not None}
    limited = [q for q in verdict.quantities if q.limit_verdict is not None]
    claims = {claim.constraint.name: claim for claim in verdict.claim.limits}
    for quantity in verdict.quantities:
        if quantity.objective:
            yield _row(quantity, "mean, objective", _change(quantity))
    for quantity in limited:
        mean = means.get(quantity.metric)
        change = _change(quantity)
        if quantity.change is Change.UNKNOWN and mean is not None and not mean.objective:
            change = f"mean {_change(mean)}"
        yield _limit(quantity, change, verdict, claims.get(quantity.constraint))
    metrics = {q.metric for q in limited}
    for quantity in gains(verdict):
        if not quantity.objective and quantity.metric not in metrics:
            yield _row(quantity, "mean", _change(quantity))
    if not limited and verdict.infeasible is not None:
        yield from _reached(verdict.infeasible)


def _row(quantity: Quantity, detail: str, change: str) -> Row:
    title = with_unit(quantity.title, quantity.unit)
    return Row(title, detail, *quantity.values_in_words, change)


def _limit(quantity: Quantity, change: str, verdict: Verdict, claim: ClaimedLimit | None) -> Row:
    found = quantity.limit_verdict
    if found is None:
        raise ValueError(f"{quantity.label} has no limit")
    status, shown = _found(found)
    return Row(
        with_unit(found.title, quantity.unit),
        _detail(quantity, found),
        *quantity.values_in_words,
        change,
        bar=bar(quantity.default, quantity.tuned, quantity.limit),
        limit=f"{'≤' if found.constraint.sign > 0.0 else '≥'} {quantity.limit_in_words}",
        shown=shown,
        status=status,
        runs=_runs(found, claim if verdict.state is State.CERTIFIED else None),
    )


def _detail(quantity: Quantity, found: LimitVerdict) -> str:
    """Return of what the value is, and how often the limit must be kept."""
    which = quantity.label.partition(" ")[0]
    where = "every context" if found.everywhere else ""
    rule = found.constraint.rule
    often = f"{100.0 * rule.level:g} % of runs" if rule.on_runs else "mean over noise"
    return " · ".join(filter(None, (which, often, where)))


def _found(found: LimitVerdict) -> tuple[Status, str]:
    """Return what is found of a limit: good only if it is proven to be kept."""
    match found.standing:
        case Standing.SHOWN:
            return Status.GOOD, "with an assumption" if found.condition else "proven"
        case Standing.VIOLATED:
            return Status.BAD, "not kept" if found.refuted else "not proven"
    return (Status.WARNING if found.exceeds else Status.OPEN), "not proven"


def _runs(found: LimitVerdict, claim: ClaimedLimit | None) -> str:
    """Return how many runs are over a limit, and how many may be."""
    over, runs = (found.violations, found.runs) if claim is None else (claim.over, claim.runs)
    said = f"{over} of {counted(runs, 'run')} {'over' if found.constraint.sign > 0.0 else 'under'}"
    if not found.constraint.rule.on_runs:
        return said
    return f"{said}, {100.0 * found.constraint.allowed:.3g} % may"


def _change(quantity: Quantity) -> str:
    difference = quantity.difference
    if difference is None or not isfinite(difference.mean):
        return "–"
    half = 0.5 * (difference.high - difference.low)
    if quantity.change is Change.NONE:
        return f"as before (±{half:.2g})"
    percent = quantity.percent
    return f"{difference.mean:+.3g}" if isnan(percent) else f"{percent:+.0f} %"


def bar(default: float, tuned: float, limit: float) -> Bar | None:
    """Return values against a limit; None for what has no share of it."""
    if not (limit > 0.0 and tuned >= 0.0):
        return None
    known = default if default >= 0.0 else nan
    largest = max(value for value in (tuned, known, PLACE * limit) if not isnan(value))
    scale = max(limit / PLACE, min(largest, 2.0 * limit))
    return Bar(min(known / scale, 1.0), min(tuned / scale, 1.0), limit / scale)


def _reached(facts: Infeasible) -> Sequence[Row]:
    """Return how the trials of a run without a validated result did on each limit."""
    return [
        Row(
            with_unit(item.title, item.unit),
            "best of the trials",
            "–",
            "–" if item.best is None else shown_beside(item.best.value, item.limit),
            "",
            None if item.best is None else bar(nan, item.best.value, item.limit),
            f"{'≤' if item.upper else '≥'} {item.limit:g}",
            "not kept" if item.broke == item.trials else "kept by some",
            Status.BAD if item.broke == item.trials else Status.OPEN,
            f"{item.broke} of {counted(item.trials, 'trial')} over",
        )
        for item in facts.limits
        if item.trials
    ]
