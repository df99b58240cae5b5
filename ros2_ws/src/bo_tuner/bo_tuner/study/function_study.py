"""A study of a Python function: in a study file, the function is its only node."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.study.metrics import COMPUTED, ReportedMetric, metric_kind
from bo_tuner.study.study import Study

FUNCTION = "function"
"""Name of the node that stands for the function, and of the backend that calls it."""

_ON_NODES = ("nodes", "trigger", "run", "signals", "seed_parameter")


def with_function(mapping: object) -> object:
    """Return what a study file holds, with the function as the only node if it names none.

    All parameters, contexts and reported metrics are the function's. What is wrong otherwise is
    left for the checks of the study.
    """
    if not isinstance(mapping, dict) or any(key in mapping for key in _ON_NODES):
        return mapping
    completed: dict[Any, object] = dict(mapping)
    completed["nodes"] = {FUNCTION: {"node": FUNCTION, "result": "~/result"}}
    completed["trigger"] = {"node": FUNCTION, "service": "~/run"}
    for section in ("parameters", "contexts", "metrics"):
        items = completed.get(section)
        if isinstance(items, dict):
            completed[section] = {name: _of_function(section, item) for name, item in items.items()}
    return completed


def _of_function(section: str, item: object) -> object:
    if not isinstance(item, dict):
        return item
    if section == "metrics" and metric_kind(item) is not ReportedMetric:
        return item
    return {"node": FUNCTION, **item}


def returned_metrics(study: Study) -> dict[str, ReportedMetric]:
    """Return the metrics that a function returns, by name: all but those computed from others.

    Raises
    ------
    StudyError
        If one is computed from the signals of a run, which a function does not have.
    """
    returned = {}
    for name, metric in study.metrics.items():
        if isinstance(metric, ReportedMetric):
            returned[name] = metric
        elif not isinstance(metric, COMPUTED):
            raise StudyError(
                "is computed from signals; a function needs metrics that it returns",
                ("metrics", name),
            )
    if study.trigger is None:
        raise StudyError("expected trigger: a function has no steps", ("run",))
    return returned


def problem_of_returned(metrics: Mapping[str, object], returned: object) -> str:
    """Return in a line why this is not what a function is to return; empty if it is.

    Whether the values can be those of metrics is judged elsewhere: a run may have diverged.

    Parameters
    ----------
    metrics
        Those that it is to return, by name.
    returned
        What it has returned.
    """
    expected = f"expected a number for each of {', '.join(metrics)}"
    if not isinstance(returned, Mapping):
        return f"{expected}, found {checks.show(returned)}"
    if missing := [name for name in metrics if name not in returned]:
        names = ", ".join(str(name)[:60] for name in returned) or "nothing"
        return f"metric {missing[0]} is missing; {expected}, found {names}"
    for name, value in returned.items():
        if name not in metrics:
            return f"{checks.quoted(str(name))} is no metric that it returns; {expected}"
        if not _is_number(value):
            return f"metric {name}: expected a number, found {checks.show(value)}"
    return ""


def _is_number(value: object) -> bool:
    if isinstance(value, bool | np.bool_ | str | bytes):
        return False
    try:
        float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return False
    return True
