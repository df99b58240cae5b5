"""Which metrics only grow during a run, so that a run may be cut short by what they have so far.

Such a metric of the first part of a run is a lower bound of the metric of the whole run. Whether
one is of this kind follows from its measure; a node has to say it of what it reports.
"""

from collections.abc import Iterable, Mapping, Sequence

from bo_tuner.errors import StudyError
from bo_tuner.numerics.signal_metrics import NEVER_FALLS
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.lag_metric import LagMetric
from bo_tuner.study.metrics import (
    COMPUTED,
    PythonMetric,
    ReportedMetric,
    SignalMetric,
    StudyMetric,
)
from bo_tuner.study.parts import MINIMIZE, Objective
from bo_tuner.study.trajectory_metric import TrajectoryMetric


def why_not(metric: StudyMetric) -> str:
    """Return in a few words why a metric may fall during a run; empty if it only grows."""
    if isinstance(metric, ReportedMetric):
        return "" if metric.grows else "its entry does not say `grows: true`"
    if isinstance(metric, COMPUTED):
        return "it is computed from other metrics"
    if isinstance(metric, PythonMetric):
        return "it is a function of a whole run"
    if isinstance(metric, LagMetric):
        return "it is of two whole signals"
    if isinstance(metric, TrajectoryMetric):
        return "it is of a whole trajectory"
    if metric.measure not in NEVER_FALLS:
        return f"{metric.measure} may fall during a run"
    if isinstance(metric, SignalMetric) and isinstance(metric.target, str):
        return f"its target, {metric.target}, is only known at the end; expected a number"
    return ""


def decisive(
    metrics: Mapping[str, StudyMetric],
    constraints: Iterable[Constraint],
    objectives: Sequence[Objective],
) -> list[str]:
    """Return the names of the metrics by which a run may be cut short.

    They only grow, and either have an upper limit or are the objective, which is minimized. Where
    there are several objectives, a run is never decided by one of them.
    """
    return [
        name
        for name in _bounded_above(constraints, objectives)
        if name in metrics and not why_not(metrics[name])
    ]


def check_cut_short(
    metrics: Mapping[str, StudyMetric],
    constraints: Iterable[Constraint],
    objectives: Sequence[Objective],
    measured: Sequence[str],
) -> None:
    """Refuse `cut_short` where no run can be decided before its end.

    Raises
    ------
    StudyError
        If that is so, with what would help.
    """
    if measured:
        raise StudyError(
            f"a run that is cut short has no measured context, such as {measured[0]}; "
            "expected a study without `measured`"
        )
    constraints = tuple(constraints)
    if decisive(metrics, constraints, objectives):
        return
    reasons = [
        f"{name}: {why_not(metrics[name])}"
        for name in _bounded_above(constraints, objectives)
        if name in metrics
    ]
    raise StudyError(
        "no metric with an upper limit, and no minimized objective, only grows during a run "
        f"({'; '.join(reasons) or 'there is none'})"
    )


def _bounded_above(
    constraints: Iterable[Constraint], objectives: Sequence[Objective]
) -> Iterable[str]:
    """Return the names of the metrics that are not to be too large."""
    names = [item.metric for item in constraints if item.sign > 0.0]
    if len(objectives) == 1 and objectives[0].direction == MINIMIZE:
        names.append(objectives[0].metric)
    return dict.fromkeys(names)
