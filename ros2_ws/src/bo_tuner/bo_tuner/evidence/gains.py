"""What tuning has gained, metric by metric: the facts of the headline."""

from collections.abc import Iterator, Sequence
from math import isnan

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.verdict import Verdict

MOST = 3
"""Metrics, beside the objectives and what is worse, that a headline has room for."""


def gains(verdict: Verdict) -> tuple[Quantity, ...]:
    """Return a number for each objective, and for each other metric that has changed.

    What is better comes first, then what is lower or higher, what is worse, and objectives as
    before; of a metric with several numbers it is the mean, or else that of its limit.
    """
    by_metric: dict[str, Quantity] = {}
    for quantity in sorted(verdict.quantities, key=lambda q: q.estimates is None):
        known = by_metric.get(quantity.metric)
        if known is None or known.change is Change.UNKNOWN:
            by_metric[quantity.metric] = quantity
    limited = {q.metric for q in verdict.quantities if q.constraint}
    told = sorted(_told([*by_metric.values()], limited), key=lambda q: ORDER.index(q.change))
    return tuple(told)


ORDER = (
    Change.BETTER,
    Change.LOWER,
    Change.HIGHER,
    Change.WORSE,
    Change.NONE,
    Change.UNKNOWN,
)


def _told(quantities: Sequence[Quantity], limited: set[str]) -> Iterator[Quantity]:
    yield from (q for q in quantities if q.objective or q.change is Change.WORSE)
    others = [
        q
        for q in quantities
        if q.change in (Change.BETTER, Change.LOWER, Change.HIGHER) and not q.objective
    ]
    # What is limited matters most, then what has changed the most.
    others.sort(key=lambda q: (q.metric not in limited, isnan(q.percent), -abs(q.percent)))
    yield from others[:MOST]
