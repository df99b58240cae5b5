"""The scale on which a limited metric is modelled: a key of each metric."""

from collections.abc import Iterable, Mapping
from typing import Protocol

from bo_tuner.errors import StudyError
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.parts import LOG


class HasScale(Protocol):
    """A metric with the key."""

    @property
    def scale(self) -> str:
        """`linear` or `log`."""


def check_limits(metric: HasScale, constraint: Constraint) -> None:
    """Refuse a limit that has no logarithm, on a metric with the scale ``log``."""
    for key, limit in (("upper", constraint.upper), ("lower", constraint.lower)):
        if metric.scale == LOG and limit is not None and limit <= 0.0:
            raise StudyError(
                f"expected a limit above 0 on a metric with the scale log, found {limit:g}", (key,)
            )


def check_scales(metrics: Mapping[str, HasScale | None], constraints: Iterable[Constraint]) -> None:
    """Refuse a scale that has no effect, of a metric without a limit; None was refused itself."""
    limited = {constraint.metric for constraint in constraints}
    for name, metric in metrics.items():
        if metric is not None and metric.scale == LOG and name not in limited:
            raise StudyError(
                f"has no effect: there is no limit on {name}; leave it out, or if it is the "
                "objective, write objective: {metric: " + name + ", scale: log}",
                (name, "scale"),
            )
