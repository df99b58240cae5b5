"""Measured contexts: metrics of the surroundings of a run, such as wind, that nobody sets."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.codec.rules import Expected
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.metrics import COMPUTED, RelativeMetric, StudyMetric
from bo_tuner.study.parts import Objective
from bo_tuner.trials import Evaluation


def _each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise StudyError(f"'{name}' is there twice", (index,))
    return names


Measured = Annotated[tuple[str, ...], Expected("a list of metrics"), _each_once]


def check_measured(
    measured: Sequence[str],
    metrics: Mapping[str, StudyMetric],
    contexts: Collection[str],
    objectives: Iterable[Objective],
    constraints: Mapping[str, Constraint],
) -> None:
    """Refuse measured contexts that no run measures, or that the study sets, optimizes or limits.

    Raises
    ------
    StudyError
        With the key path in the study file.
    """
    for index, name in enumerate(measured):
        path = ("measured", index)
        checks.reference(name, "metric", metrics, *path)
        if isinstance(metrics[name], COMPUTED):
            raise StudyError(
                f"metric '{name}' is computed from others; expected one of a run", path
            )
        if name in contexts:
            raise StudyError(
                f"'{name}' is also a context, which is set; expected another name", path
            )
        if any(_of(metrics, objective.metric) == name for objective in objectives):
            raise StudyError(f"'{name}' is the objective; what is measured is not optimized", path)
        for constraint in constraints.values():
            if _of(metrics, constraint.metric) == name:
                raise StudyError(
                    f"constraints.{constraint.name} limits '{name}'; what is measured depends on "
                    "no parameter, and is not limited",
                    path,
                )


def _of(metrics: Mapping[str, StudyMetric], name: str) -> str:
    """Return the metric that a relative one is computed from; any other metric itself."""
    metric = metrics.get(name)
    return metric.relative if isinstance(metric, RelativeMetric) else name


@dataclass(frozen=True)
class SeenRange:
    """Range of a measured context in some runs.

    Attributes
    ----------
    low, high, mean
        Over the runs, in its unit.
    """

    low: float
    high: float
    mean: float


def seen_in(measured: Sequence[str], evaluations: Iterable[Evaluation]) -> dict[str, SeenRange]:
    """Return by name the ranges in the complete evaluations; empty if there are none."""
    rows = values_in(measured, evaluations)
    if not len(rows):
        return {}
    ranges = zip(measured, rows.min(axis=0), rows.max(axis=0), rows.mean(axis=0), strict=True)
    return {
        name: SeenRange(float(low), float(high), float(mean)) for name, low, high, mean in ranges
    }


def values_in(measured: Sequence[str], evaluations: Iterable[Evaluation]) -> Array:
    """Return the values (n, w) of w measured contexts in the n complete evaluations."""
    complete = [e.outcome.metrics for e in evaluations if e.outcome.complete]
    rows = [[metrics[name] for name in measured] for metrics in complete]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(measured))
