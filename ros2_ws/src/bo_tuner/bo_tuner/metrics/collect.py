"""From what the nodes say of an evaluation to the study's metrics."""

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite

from bo_tuner import maxima
from bo_tuner.codec.checks import holds
from bo_tuner.metrics.source import MetricSource, MissingMetricError, Results, reported_sources
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.study import named_code
from bo_tuner.study.metrics import CombinedMetric, RelativeMetric, ReportedMetric
from bo_tuner.study.study import Study
from bo_tuner.text import MOST_SAID, brief
from bo_tuner.trials import EvaluationState, Outcome

STATUS_OK = "ok"
STATUS_CUT_SHORT = "cut short"
"""Status of a run that an object has ended early, as it was asked to."""
LARGEST_METRIC = maxima.MAGNITUDE
"""Largest magnitude of a metric; beyond, a run has diverged, and nothing was measured."""

NO_LOGARITHM = "its log scale needs a positive value"
"""Why an evaluation failed that has another value."""


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
        self._sources = reported_sources(study) | dict(sources or {})

    def outcome(self, results: Results, assigned: Results | None = None) -> Outcome:
        """Judge an evaluation.

        Parameters
        ----------
        results
            By node key what the node reported: ``status``, ``reason`` and its figures, as numbers
            or as text.
        assigned
            By node key the parameters that were set; what a node reports under the name of one is
            the value that it ran with.

        Returns
        -------
        Outcome
            Without metrics that are relative to the default, which
            `backends.layers.beside_default` adds. Failed if a node ran with another parameter, if
            it says so or sends more than `maxima.ANSWER` values, if a metric is missing, no number,
            not finite or beyond `LARGEST_METRIC`, or if a metric with a logarithmic scale is not
            positive. With the status
            `Unusable.DISTURBED` a node says that somebody else had a hand in the evaluation.
        """
        for node, pairs in results.items():
            if not isinstance(pairs, Mapping):
                reason = f"{node}: answered {type(pairs).__name__}; expected a mapping"
                return Outcome(EvaluationState.FAILED, {}, reason)
            if len(pairs) > maxima.ANSWER:
                reason = (
                    f"{node}: reports {len(pairs)} values; at most {maxima.ANSWER} are accepted"
                )
                return Outcome(EvaluationState.FAILED, {}, reason)
        details = {
            f"{node}.{_text(key)[:MOST_SAID]}": _text(value)[:MOST_SAID]
            for node, pairs in results.items()
            for key, value in pairs.items()
        }
        if mismatch := self._mismatch(results, assigned or {}):
            return Outcome(EvaluationState.FAILED, {}, brief(mismatch), details)
        for node, pairs in results.items():
            if pairs.get("status") != STATUS_OK:
                reason = f"{node}: {brief(str(pairs.get('reason') or 'no reason given'))}"
                is_disturbed = pairs.get("status") == Unusable.DISTURBED
                notes = Notes(unusable=Unusable.DISTURBED if is_disturbed else None)
                return Outcome(EvaluationState.FAILED, {}, reason, details, notes=notes)
        metrics: dict[str, float] = {}
        # Metrics that are computed from others come after these.
        ordered = sorted(
            self._study.metrics.items(), key=lambda item: isinstance(item[1], CombinedMetric)
        )
        for name, metric in ordered:
            if isinstance(metric, RelativeMetric):
                continue
            try:
                value: object
                if isinstance(metric, CombinedMetric):
                    value = metric.value(metrics)
                else:
                    value = self._sources[name].value(results)
            except MissingMetricError as error:
                return Outcome(EvaluationState.FAILED, {}, brief(str(error)), details)
            if problem := metric_problem(value):
                reason = f"metric {name} is {problem}"
                if isinstance(metric, ReportedMetric):
                    reason = f"{metric.node}: metric {metric.key} is {problem}"
                return Outcome(EvaluationState.FAILED, {}, reason, details)
            metrics[name] = float(value)  # type: ignore[arg-type]
        metrics = {name: metrics[name] for name in self._study.metrics if name in metrics}
        return judged(self._study, Outcome(EvaluationState.COMPLETE, metrics, "", details))

    def _mismatch(self, results: Results, assigned: Results) -> str:
        """Return in words a parameter for which a node reports another value than it was given."""
        reported = [m for m in self._study.metrics.values() if isinstance(m, ReportedMetric)]
        metrics = {(metric.node, metric.key) for metric in reported}
        for node, pairs in results.items():
            for name, value in assigned.get(node, {}).items():
                if name not in pairs or (node, name) in metrics:
                    continue
                if not _agrees(value, pairs[name]):
                    return f"{node}: ran with parameter {name} {pairs[name]}, expected {value}"
        return ""


def cut_short(
    study: Study,
    beyond: Mapping[str, float],
    seconds: float,
    so_far: Mapping[str, object],
    details: Mapping[str, str] | None = None,
) -> Outcome:
    """Return the outcome of a run that was ended early, since it was decided.

    Parameters
    ----------
    study
        The study.
    beyond
        By metric the value beyond which a run is decided, in its unit.
    seconds
        Time of the run [s] at which it was ended.
    so_far
        The metrics that only grow, by name, as they were by then.
    details
        Further values that the nodes reported, as text.

    Returns
    -------
    Outcome
        Failed if a value is none, or nothing was decided.
    """
    known: dict[str, float] = {}
    for name, value in so_far.items():
        if problem := metric_problem(value):
            return Outcome(EvaluationState.FAILED, {}, f"metric {name} is {problem}", details or {})
        known[name] = float(value)  # type: ignore[arg-type]
    decided = [name for name, most in beyond.items() if known.get(name, most) > most]
    if not decided:
        reason = f"ended early after {seconds:.3g} s, but no metric was beyond its bound"
        return Outcome(EvaluationState.FAILED, {}, reason, details or {})
    words = (
        f"{study.metrics[name].title} at least {known[name]:.3g} {study.metrics[name].unit}".strip()
        for name in decided
    )
    return Outcome.cut_short(seconds, known, ", ".join(words), details)


def judged(study: Study, outcome: Outcome) -> Outcome:
    """Return an outcome, as failed if a metric with a logarithmic scale is not positive."""
    if outcome.complete:
        for metric in study.logarithmic_metrics:
            if (value := outcome.metrics[metric]) <= 0.0:
                reason = f"metric {metric} is {value}; {NO_LOGARITHM}"
                return replace(outcome, state=EvaluationState.FAILED, metrics={}, reason=reason)
    return outcome


def metric_problem(value: object) -> str:
    """Return in a few words why this cannot be the value of a metric; empty if it can."""
    shown = brief(_text(value)[:40]) or "empty"
    if isinstance(value, bool):
        return shown
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return shown
    except named_code.faults() as error:
        # The object's own conversion to a number may raise anything.
        return f"a {type(value).__name__} that is no number: {named_code.described(error)}"
    if not isfinite(number):
        return shown
    if abs(number) > LARGEST_METRIC:
        return f"{shown}, beyond {LARGEST_METRIC:g}"
    return ""


def _text(value: object) -> str:
    """Return a value as text, or its type if it has none."""
    try:
        return str(value)
    except named_code.faults():
        return f"a {type(value).__name__}"


def _agrees(value: object, reported: object) -> bool:
    """Whether a node reports the value of a parameter, as it is or as text."""
    if not isinstance(value, bool | int | float | str):
        return True  # There is no one way to write a list.
    if not isinstance(reported, str) or isinstance(value, str):
        return holds(reported, value)
    try:
        if isinstance(value, bool):
            return reported.lower() == str(value).lower()
        return holds(int(reported) if reported.isdigit() else float(reported), value)
    except ValueError:
        return False
