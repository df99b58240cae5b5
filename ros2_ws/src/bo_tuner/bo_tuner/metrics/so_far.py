"""The metrics that only grow, of a run in progress."""

import contextlib
from collections.abc import Iterable

from bo_tuner.metrics.path_source import PathSource
from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.metrics.signal_sources import SignalSource
from bo_tuner.metrics.source import MetricSource
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.path_metric import PathMetric
from bo_tuner.study.study import Study


class MetricsSoFar:
    """Computes metrics of the signals that were recorded so far.

    Parameters
    ----------
    study
        The study, for its metrics that only grow during a run.
    """

    def __init__(self, study: Study) -> None:
        self._recording: Recording = NOTHING_RECORDED
        self._sources: dict[str, MetricSource] = {}
        for name in study.growing_metrics:
            metric = study.metrics[name]
            if isinstance(metric, SignalMetric):
                self._sources[name] = SignalSource(metric, study, lambda: self._recording)
            elif isinstance(metric, PathMetric):
                self._sources[name] = PathSource(metric, study, lambda: self._recording)

    def of(self, recording: Recording, names: Iterable[str] | None = None) -> dict[str, float]:
        """Return the metrics by name that have a value yet, of `names` or of all that grow."""
        self._recording = recording
        values: dict[str, float] = {}
        for name in self._sources if names is None else names:
            # Before its first messages a signal has none, and before it moves no step.
            with contextlib.suppress(ValueError, IndexError):
                values[name] = float(self._sources[name].value({}))  # type: ignore[arg-type]
        return values
