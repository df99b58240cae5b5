"""By how much a signal was behind another one in a run."""

from collections.abc import Callable

import numpy as np

from bo_tuner.metrics.recording import Recording
from bo_tuner.metrics.source import MissingMetricError, Results
from bo_tuner.numerics.correlation import lag
from bo_tuner.study.lag_metric import LagMetric

MOST_SAMPLES = 20_000
"""Of a signal that comes more often, samples in larger distances are taken."""


class LagSource:
    """Computes the lag of a signal in the last run.

    Parameters
    ----------
    metric
        The metric.
    recording
        Returns what was recorded in the last run.
    """

    def __init__(self, metric: LagMetric, recording: Callable[[], Recording]) -> None:
        self._metric = metric
        self._recording = recording

    def value(self, results: Results) -> float:
        """Return the value; `results` is not used."""
        metric, signals = self._metric, self._recording().signals
        late, early = signals[metric.lag], signals[metric.behind]
        if min(len(late.time), len(early.time)) < 2:
            raise MissingMetricError(f"metric {metric.name}: a signal has less than two messages")
        begin, end = max(late.time[0], early.time[0]), min(late.time[-1], early.time[-1])
        # Finer than the messages nothing is known.
        step = max(
            min(float(np.median(np.diff(signal.time))) for signal in (late, early)),
            (end - begin) / MOST_SAMPLES,
        )
        if not end - begin > 4.0 * metric.most or not step < metric.most:
            raise MissingMetricError(
                f"metric {metric.name}: expected messages for more than {4.0 * metric.most:g} s, "
                f"four times `most`, and several in {metric.most:g} s"
            )
        times = np.arange(begin, end, step)
        found = lag(
            np.interp(times, late.time, late.value),
            np.interp(times, early.time, early.value),
            int(np.ceil(metric.most / step)),
        )
        if np.isnan(found):
            raise MissingMetricError(f"metric {metric.name}: a signal does not change")
        return float(np.clip(found * step, -metric.most, metric.most))
