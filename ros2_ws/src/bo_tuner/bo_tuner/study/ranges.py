"""The declared range of a metric: no run has a value beyond it, whatever happens.

A certificate relies on it, and no sample can show it: it bounds rare runs, which nobody has seen.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.metric_keys import Range
from bo_tuner.trials import Evaluation


def check_limit(constraint: Constraint, declared: Range | None) -> None:
    """Refuse a limit outside the range of its metric, which every run or no run keeps.

    Raises
    ------
    StudyError
        If the limit is not inside the range.
    """
    if declared is None or declared[0] < constraint.limit < declared[1]:
        return
    low, high = declared
    end = high if constraint.sign > 0.0 else low
    certain = "break" if constraint.sign * (constraint.limit - end) >= 0.0 else "keep"
    raise StudyError(
        f"no run can {certain} it: expected a limit inside the range of {constraint.metric}, "
        f"[{low:g}, {high:g}] (metrics.{constraint.metric}.range), found {constraint.limit:g}",
        (constraint.side,),
    )


def check_free(constraints: Iterable[Constraint], declared: Mapping[str, Range | None]) -> None:
    """Refuse a limit on a mean that no certificate can show without an assumption on the noise.

    Raises
    ------
    StudyError
        If there is one on a metric without a range.
    """
    for constraint in constraints:
        if not constraint.rule.on_runs and declared.get(constraint.metric) is None:
            raise StudyError(
                f"constraint {constraint.name} limits a mean, of which nothing is known without an "
                f"assumption on the noise: give metrics.{constraint.metric} a range, or the "
                "constraint a probability",
                ("certificate", "distribution_free"),
            )


@dataclass(frozen=True)
class OutOfRange:
    """A run has a value of a metric outside its declared range."""

    metric: str
    value: float
    low: float
    high: float


def outside(metrics: Mapping[str, Any], evaluations: Iterable[Evaluation]) -> OutOfRange | None:
    """Return the first value outside the range of its metric; None if there is none."""
    declared = {name: m.range for name, m in metrics.items() if m.range is not None}
    for evaluation in evaluations if declared else ():
        for name, (low, high) in declared.items():
            value = evaluation.outcome.metrics.get(name)
            if evaluation.outcome.complete and value is not None and not low <= value <= high:
                return OutOfRange(name, value, low, high)
    return None
