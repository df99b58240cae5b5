"""The distance of an estimated trajectory from the true one in a run."""

from collections.abc import Callable, Sequence

import numpy as np

from bo_tuner.metrics.path_source import measured
from bo_tuner.metrics.recording import Recording
from bo_tuner.metrics.source import MissingMetricError, Results
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.trajectories import absolute_errors, relative_errors
from bo_tuner.study.trajectory_metric import TrajectoryMetric


class TrajectorySource:
    """Computes a metric of an estimated trajectory in the last run.

    Parameters
    ----------
    metric
        The metric.
    recording
        Returns what was recorded in the last run.
    """

    def __init__(self, metric: TrajectoryMetric, recording: Callable[[], Recording]) -> None:
        self._metric = metric
        self._recording = recording

    def value(self, results: Results) -> float:
        """Return the value; `results` is not used."""
        return measured(self._metric, *self._errors(self._recording()))

    def _errors(self, recording: Recording) -> tuple[Array, Array]:
        """Return times (n,) [s] and distances (n,) [m]."""
        metric = self._metric
        known = [recording.signals[name] for name in metric.signals]
        begin = max((signal.time[0] for signal in known if len(signal.time)), default=np.inf)
        end = min((signal.time[-1] for signal in known if len(signal.time)), default=-np.inf)
        times = recording.signals[metric.estimate[0]].time
        times = times[(times >= begin) & (times <= end)]
        if not all(len(signal.time) for signal in known) or len(times) < 2:
            raise MissingMetricError(
                f"metric {metric.name}: truth and estimate have no time in common"
            )

        def at(names: Sequence[str], *, angles: bool = False) -> Array:
            signals = [recording.signals[name] for name in names]
            values = [np.unwrap(s.value) if angles else s.value for s in signals]
            pairs = zip(signals, values, strict=True)
            return np.column_stack([np.interp(times, s.time, value) for s, value in pairs])

        truth, estimate = at(metric.truth), at(metric.estimate)
        if metric.over is None:
            return times, absolute_errors(truth, estimate, align=metric.align)
        yaw, estimated = at(metric.yaw, angles=True).T
        moments, errors = relative_errors(times, truth, yaw, estimate, estimated, metric.over)
        if len(moments) < 2:
            raise MissingMetricError(
                f"metric {metric.name}: the run is not longer than {metric.over:g} s"
            )
        return moments, errors
