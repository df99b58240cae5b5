"""Metrics that are computed from the signals of a run."""

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.metrics.lag_source import LagSource
from bo_tuner.metrics.path_source import PathSource
from bo_tuner.metrics.python_process import PythonProcess
from bo_tuner.metrics.python_worker import Passed
from bo_tuner.metrics.recording import Recording
from bo_tuner.metrics.source import MetricSource, MissingMetricError, Results
from bo_tuner.metrics.trajectory_source import TrajectorySource
from bo_tuner.numerics.expressions import Expression
from bo_tuner.numerics.signal_metrics import (
    FROM_START,
    MEASURES,
    UndefinedMetricError,
    options_of,
)
from bo_tuner.study.lag_metric import LagMetric
from bo_tuner.study.metrics import PythonMetric, SignalMetric
from bo_tuner.study.path_metric import PathMetric
from bo_tuner.study.signals import expression
from bo_tuner.study.study import Study
from bo_tuner.study.trajectory_metric import TrajectoryMetric


class SignalSource:
    """Computes a metric of the signals of the last run.

    Parameters
    ----------
    metric
        The metric.
    study
        The study, for its signals.
    recording
        Returns what was recorded in the last run.
    """

    def __init__(
        self, metric: SignalMetric, study: Study, recording: Callable[[], Recording]
    ) -> None:
        self._metric = metric
        self._recording = recording
        self._of = expression(metric.of, study.signals)
        self._target = (
            expression(metric.target, study.signals) if isinstance(metric.target, str) else None
        )

    def value(self, results: Results) -> float:
        """Return the value; of `results` nothing is needed."""
        recording = self._recording()
        metric = self._metric
        options = {key: getattr(metric, key) for key in options_of(metric.measure)}
        if self._target is not None:
            target = float(recording.sample(self._target)[1][-1])
            if not np.isfinite(target):
                # There is no step without a target.
                raise MissingMetricError(
                    f"metric {metric.name}: its target, {metric.target}, is undefined at the end"
                )
            options["target"] = target
        # The value at the start is of an earlier message: dated there, it changes too steeply.
        time, value = recording.sample(self._of, held=metric.measure != "largest_rate")
        if not np.isfinite(value).all():
            when = time[np.flatnonzero(~np.isfinite(value))[0]]
            raise MissingMetricError(
                f"metric {metric.name}: {metric.of} is undefined at {when:.3f} s"
            )
        if metric.measure in FROM_START and time[0] > 0.0:
            time, value = np.append(0.0, time), np.append(0.0, value)
        try:
            given = {key: item for key, item in options.items() if item is not None}
            return MEASURES[metric.measure](time, value, **given)
        except UndefinedMetricError as error:
            raise MissingMetricError(f"metric {metric.name}: {metric.of} {error}") from None


class PythonSource:
    """Computes a metric of the signals of the last run by a function of the user.

    It runs in a process of its own. It is passed, by their names, the times (n,) [s] and values
    (n,) of all signals that have messages, and returns the value. The first time is 0, or
    that of the first message, the last one is the end of the run, and a value holds until the next
    one. For a signal of whole messages it is passed their times and the messages themselves (n);
    the message that holds at the start has the time 0.

    Parameters
    ----------
    metric
        The metric.
    recording
        Returns what was recorded in the last run.
    process
        Where the function runs.

    Raises
    ------
    StudyError
        If the function cannot be imported.
    """

    def __init__(
        self, metric: PythonMetric, recording: Callable[[], Recording], process: PythonProcess
    ) -> None:
        self._metric = metric
        self._recording = recording
        self._process = process
        if problem := process.load(metric.python):
            raise StudyError(problem, ("metrics", metric.name, "python"))

    def value(self, results: Results) -> float:
        """Return the value; of `results` nothing is needed."""
        recording = self._recording()
        signals: dict[str, Passed] = {
            name: recording.sample(Expression(name, (name,)))
            for name, seen in recording.signals.items()
            if len(seen.time)
        }
        for name, heard in recording.messages.items():
            if len(heard.time):
                signals[name] = (np.maximum(heard.time, 0.0), (heard.type, heard.data))
        metric = self._metric
        try:
            return self._process.compute(metric.python, signals, metric.timeout)
        except MissingMetricError as error:
            raise MissingMetricError(f"metric {metric.name}: {error}") from None


@contextlib.contextmanager
def signal_sources(
    study: Study,
    recording: Callable[[], Recording],
    interrupted: Callable[[], None] = lambda: None,
) -> Iterator[dict[str, MetricSource]]:
    """Make the source of each metric of a study that is computed from signals.

    Parameters
    ----------
    study
        The study.
    recording
        Returns what was recorded in the last run.
    interrupted
        Called while a function of the study computes; what it raises ends the function.

    Yields
    ------
    dict
        The sources, by the name of the metric.

    Raises
    ------
    StudyError
        If a function that the study names cannot be imported.
    """
    sources: dict[str, MetricSource] = {}
    with contextlib.closing(PythonProcess(study.folder, interrupted)) as process:
        for name, metric in study.metrics.items():
            if isinstance(metric, SignalMetric):
                sources[name] = SignalSource(metric, study, recording)
            elif isinstance(metric, PathMetric):
                sources[name] = PathSource(metric, study, recording)
            elif isinstance(metric, TrajectoryMetric):
                sources[name] = TrajectorySource(metric, recording)
            elif isinstance(metric, LagMetric):
                sources[name] = LagSource(metric, recording)
            elif isinstance(metric, PythonMetric):
                sources[name] = PythonSource(metric, recording, process)
        yield sources
