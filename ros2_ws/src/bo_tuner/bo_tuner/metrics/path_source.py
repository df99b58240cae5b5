"""The distance of a path from the plan that holds at the time."""

from collections.abc import Callable

import numpy as np

from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.source import MissingMetricError, Results
from bo_tuner.metrics.stored_messages import decoded
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.polyline import distances
from bo_tuner.numerics.signal_metrics import MEASURES, UndefinedMetricError
from bo_tuner.study.distance_metric import DistanceMetric
from bo_tuner.study.path_metric import PLAN_TYPE, PathMetric
from bo_tuner.study.study import Study


def measured(metric: DistanceMetric, time: Array, distance: Array) -> float:
    """Return what a metric measures of distances (n,) at times (n,) [s]."""
    options = {} if metric.percent is None else {"percent": metric.percent}
    try:
        return MEASURES[metric.measure](time, distance, **options)
    except UndefinedMetricError as error:
        raise MissingMetricError(f"metric {metric.name}: the distance {error}") from None


class PathSource:
    """Computes a metric of the distance of a path from a plan in the last run.

    Parameters
    ----------
    metric
        The metric.
    study
        The study, for the frames of its signals.
    recording
        Returns what was recorded in the last run.
    """

    def __init__(
        self, metric: PathMetric, study: Study, recording: Callable[[], Recording]
    ) -> None:
        self._metric = metric
        frames = [study.signals[name].frames for name in metric.path]
        self._frame = next((pair[0] for pair in frames if pair is not None), "")
        self._recording = recording

    def value(self, results: Results) -> float:
        """Return the value; `results` is not used."""
        metric = self._metric
        time, distance = self._distance(self._recording())
        if not np.isfinite(distance).all():
            when = time[np.flatnonzero(~np.isfinite(distance))[0]]
            raise MissingMetricError(
                f"metric {metric.name}: the distance to {metric.plan} is undefined at {when:.3f} s"
            )
        return measured(metric, time, distance)

    def _distance(self, recording: Recording) -> tuple[Array, Array]:
        """Return times (n,) [s] and distances (n,) [m], from where path and plan are known."""
        metric = self._metric
        seen = recording.messages[metric.plan]
        # A signal holds the number of the plan, so that its value says which plan holds when.
        numbers = RecordedSignal(seen.time, np.arange(len(seen.time), dtype=np.float64))
        known = {name: recording.signals[name] for name in metric.path} | {metric.plan: numbers}
        time, values = Recording(known, recording.end).held(known)
        points = np.column_stack([values[name] for name in metric.path])
        plan = values[metric.plan].astype(int)
        distance = np.empty(len(time))
        for number in np.unique(plan):
            at = plan == number
            vertices = self._vertices(seen.data[number], float(time[at][0]))
            distance[at] = distances(points[at], vertices)
        return time, distance

    def _vertices(self, data: bytes, when: float) -> Array:
        """Return the positions (m, d) [m] of a plan."""
        metric = self._metric
        (message,) = decoded(PLAN_TYPE, [data])
        frame = message.header.frame_id.removeprefix("/")
        if self._frame and frame != self._frame:
            raise MissingMetricError(
                f"metric {metric.name}: {metric.plan} is in the frame '{frame}' and the path in "
                f"{self._frame}"
            )
        if not len(message.poses):
            raise MissingMetricError(
                f"metric {metric.name}: {metric.plan} has no poses at {when:.3f} s"
            )
        places = [pose.pose.position for pose in message.poses]
        return np.array([(p.x, p.y, p.z)[: len(metric.path)] for p in places])
