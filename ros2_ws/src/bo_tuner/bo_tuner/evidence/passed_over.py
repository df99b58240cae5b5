"""What the verdict says of better parameter sets that were not chosen."""

from collections.abc import Mapping, Sequence
from typing import Any

from bo_tuner.study.study import Study
from bo_tuner.text import percent, shown

NAMED = 3
"""Largest number of them that are named; the summary has all."""


def passed_over_in_words(study: Study, passed_over: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return a remark on the parameter sets that were passed over; none without any.

    Parameters
    ----------
    study
        The study.
    passed_over
        From ``summary.json``: each a `bo_tuner.methods.recommendation.PassedOver` as a mapping.
    """
    if not passed_over:
        return ()
    names = ", ".join(_in_words(study, item) for item in passed_over[:NAMED])
    more = f", and {len(passed_over) - NAMED} more" if len(passed_over) > NAMED else ""
    better = "A better compromise" if len(study.objectives) > 1 else "Better"
    return (
        f"{better} by the model, but passed over: {names}{more}. validate --trial N tests one of "
        "them.",
    )


def _in_words(study: Study, item: Mapping[str, Any]) -> str:
    metric = study.metrics[study.objective.metric]
    mean = f"{metric.name} {shown(float(item['objective']))} {metric.unit}".rstrip()
    kept = f"{percent(float(item['feasibility']))} likely within limits"
    why = "no runs were left to confirm it" if item["shown"] else "too little"
    return f"trial {int(item['trial'])} ({mean}, {kept}, {why})"
