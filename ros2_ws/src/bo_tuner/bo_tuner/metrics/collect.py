"""From what the nodes say of an evaluation to the study's metrics."""

from collections.abc import Mapping
from math import isfinite

from bo_tuner.study.study import Study
from bo_tuner.trials import EvaluationState, Outcome

STATUS_OK = "ok"
MOST_SAID = 500
"""Characters of a reason, and of a value, that are kept."""


def one_line(text: str) -> str:
    """Make what a node says fit for a line of a terminal or a table."""
    line = " ".join(text[:MOST_SAID].split())
    return "".join(c if c.isprintable() else "?" for c in line)


def outcome(study: Study, said: Mapping[str, Mapping[str, object]]) -> Outcome:
    """Judge an evaluation.

    Parameters
    ----------
    study
        The study, for its metrics.
    said
        By node key what the node said of the evaluation: ``status``, ``reason`` and its figures, as
        numbers or as text.

    Returns
    -------
    CutOutcome
        Failed if a node says so, or if a metric is missing or not finite: such a value never
        becomes a number.
    """
    details = {
        f"{node}.{str(key)[:MOST_SAID]}": str(value)[:MOST_SAID]
        for node, pairs in said.items()
        for key, value in pairs.items()
    }
    for node, pairs in said.items():
        if pairs.get("status") != STATUS_OK:
            reason = one_line(str(pairs.get("reason") or "no reason given"))
            return Outcome(EvaluationState.FAILED, {}, f"{node}: {reason}", details)
    metrics = {}
    for name, metric in study.metrics.items():
        text = said.get(metric.node, {}).get(metric.key)
        try:
            value = float(text)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            value = float("nan")
        if not isfinite(value):
            shown = "is missing" if text is None else f"is {one_line(str(text)[:40])}"
            return Outcome(
                EvaluationState.FAILED, {}, f"{metric.node}: metric {metric.key} {shown}", details
            )
        metrics[name] = value
    return Outcome(EvaluationState.COMPLETE, metrics, "", details)
