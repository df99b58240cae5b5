"""Where the value of a metric comes from."""

from collections.abc import Mapping
from typing import Protocol

from bo_tuner.codec import checks
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.study import Study

Results = Mapping[str, Mapping[str, object]]
"""What the nodes reported of an evaluation, by node key of the study, then by key."""


class MissingMetricError(ValueError):
    """What an evaluation left behind does not give the metric."""


class MetricSource(Protocol):
    """Finds the value of one metric in what an evaluation left behind."""

    def value(self, results: Results) -> object:
        """Return the value; it is judged to be a finite number elsewhere.

        Raises
        ------
        MissingMetricError
            If there is none, with the reason in one line.
        """


class ResultMessage:
    """A key of a node's result message.

    Parameters
    ----------
    node
        Key of the node in the study.
    key
        Key of the value in its message.
    """

    def __init__(self, node: str, key: str) -> None:
        self._node = node
        self._key = key

    def value(self, results: Results) -> object:
        """Return the value as the node reported it."""
        reported = results.get(self._node, {})
        value = reported.get(self._key)
        if value is None:
            meant = checks.meant(self._key, map(str, reported))
            missing = f"{self._node}: metric {self._key} is missing"
            raise MissingMetricError(f"{missing}; {meant}" if meant else missing)
        return value


def reported_sources(study: Study) -> dict[str, MetricSource]:
    """Make the source of each metric that nodes report, by the metric's name."""
    return {
        name: ResultMessage(metric.node, metric.key)
        for name, metric in study.metrics.items()
        if isinstance(metric, ReportedMetric)
    }
