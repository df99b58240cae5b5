"""From what the nodes say of an evaluation to the study's metrics."""

from collections.abc import Mapping
from math import isfinite

from bo_tuner import text
from bo_tuner.metrics.source import MetricSource, MissingMetricError, Results, sources_of
from bo_tuner.study import maxima
from bo_tuner.study.study import Study
from bo_tuner.trials import EvaluationState, Outcome

STATUS_OK = "ok"
MOST_SAID = 500
"""Characters of a reason, and of a value, that are kept."""


def one_line(said: str) -> str:
    """Make what a node says fit for a line of a terminal or a table."""
    return text.one_line(said[:MOST_SAID])


class Collector:
    """Makes the outcome of an evaluation of what the nodes reported.

    Parameters
    ----------
    study
        The study, for its metrics.
    sources
        Where each metric comes from, by name; what is left out is taken from the study.
    """

    def __init__(self, study: Study, sources: Mapping[str, MetricSource] | None = None) -> None:
        self._study = study
        self._sources = sources_of(study) | dict(sources or {})

    def outcome(self, results: Results) -> Outcome:
        """Judge an evaluation.

        Parameters
        ----------
        results
            By node key what the node reported: ``status``, ``reason`` and its figures, as numbers
            or as text.

        Returns
        -------
        Outcome
            Failed if a node says so, or more than `bo_tuner.study.maxima.ANSWER` values, or if a
            metric is missing or not finite: such a value never becomes a number.
        """
        details = {
            f"{node}.{str(key)[:MOST_SAID]}": str(value)[:MOST_SAID]
            for node, pairs in results.items()
            for key, value in pairs.items()
        }
        for node, pairs in results.items():
            if len(pairs) > maxima.ANSWER:
                reason = f"{node}: says {len(pairs)} values; at most {maxima.ANSWER} are taken"
                return Outcome(EvaluationState.FAILED, {}, reason)
        for node, pairs in results.items():
            if pairs.get("status") != STATUS_OK:
                reason = one_line(str(pairs.get("reason") or "no reason given"))
                return Outcome(EvaluationState.FAILED, {}, f"{node}: {reason}", details)
        metrics = {}
        for name, metric in self._study.metrics.items():
            try:
                found = self._sources[name].value(results)
            except MissingMetricError as error:
                return Outcome(EvaluationState.FAILED, {}, one_line(str(error)), details)
            try:
                value = float(found)  # type: ignore[arg-type]
            except (TypeError, ValueError):
                value = float("nan")
            if not isfinite(value):
                shown = one_line(str(found)[:40])
                reason = f"{metric.node}: metric {metric.key} is {shown}"
                return Outcome(EvaluationState.FAILED, {}, reason, details)
            metrics[name] = value
        return Outcome(EvaluationState.COMPLETE, metrics, "", details)
