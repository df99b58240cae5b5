"""Limits relative to the default, such as ``upper: 1.1 * default``, as limits on metrics.

A limit ``a * default + b`` on a metric y, where ``default`` is the value of y for the default in
the same context with the same seed, is a limit b on the metric ``y - a * default``. It is a
difference and not a ratio, so that it is defined where that value is 0.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings
from bo_tuner.codec.reading import read
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limit_kinds.limited import LOWER, UPPER
from bo_tuner.study.metrics import RelativeMetric, metric_kind
from bo_tuner.study.signals import named_expression

DEFAULT = "default"
"""Name, in a limit, of the value of the metric for the default."""
_STANDS_FOR = {LOWER: -1.0, UPPER: 1.0}
"""Numbers in place of the limits in checks of the other keys; they do not contradict each other."""
_HUGE = 2.0**100
"""A power of two, so that products with it are exact; every offset vanishes beside it."""


def written_out(values: Mapping[str, Any], findings: Findings) -> dict[str, Any]:
    """Return the sections of a study file with limits relative to the default written out.

    Parameters
    ----------
    values
        The sections as they are in the file.
    findings
        Collects errors in such limits; the constraint is left out then.

    Returns
    -------
    dict
        The constraints, without such limits, and the metrics; nothing if there are none.
    """
    given, known = values.get("constraints"), values.get("metrics")
    if not isinstance(given, dict) or not isinstance(known, dict):
        return {}
    metrics: dict[str, Any] = dict(known)
    constraints: dict[Any, Any] = {}
    for name, item in given.items():
        if not _is_relative(name, item):
            constraints[name] = item
            continue
        with findings.under("constraints", name):
            constraints |= _plain(name, item, given, metrics)
    return {"constraints": constraints, "metrics": metrics} if constraints != given else {}


def _is_relative(name: object, item: object) -> bool:
    return (
        isinstance(name, str)
        and isinstance(item, dict)
        and any(_is_expression(item.get(side)) for side in (LOWER, UPPER))
    )


def _is_expression(limit: object) -> bool:
    """Return whether a limit is text but no number: a number in quotes is refused elsewhere."""
    if not isinstance(limit, str):
        return False
    try:
        float(limit)
    except ValueError:
        return True
    return False


def _plain(
    name: str, item: Mapping[str, Any], others: Mapping[Any, Any], metrics: dict[str, Any]
) -> dict[str, Any]:
    """Return the constraints that one is written out to, and add their metrics to `metrics`."""
    given = {side: item[side] for side in (LOWER, UPPER) if item.get(side) is not None}
    # `Constraint` checks the other keys and splits the sides.
    whole = read(Constraint, {**item, **{side: _STANDS_FOR[side] for side in given}}, name=name)
    checks.reference(whole.metric, "metric", metrics, "metric")
    limits = {}
    for side, limit in given.items():
        limits[side] = whole.metric, limit
        if _is_expression(limit):
            factor, offset = _factor_and_offset(limit, side)
            limits[side] = _relative(whole.metric, factor, metrics, (side,)), offset
    on = {metric for metric, _ in limits.values()}
    if len(on) == 1:
        plain = {side: limit for side, (_, limit) in limits.items()}
        return {name: {**item, **plain, "metric": on.pop()}}
    split = {}
    for one in whole.sides():
        if one.name in others:
            raise StudyError(
                f"is split into '{one.name}' and another, but there is such a constraint"
            )
        metric, limit = limits[one.side]
        fields = dataclasses.asdict(one) | {"metric": metric, one.side: limit}
        split[one.name] = {k: v for k, v in fields.items() if k != "name" and v is not None}
    return split


def _relative(metric: str, factor: float, metrics: dict[str, Any], path: KeyPath) -> str:
    """Return the name of the metric minus a multiple of the default's; a new one is added."""
    if metric_kind(metrics[metric]) is RelativeMetric:
        raise StudyError(f"metric '{metric}' is relative to the default itself", path)
    multiple = "" if factor == 1.0 else f"{np.format_float_positional(factor, trim='-')}_"
    name = f"{metric}_minus_{multiple}{DEFAULT}"
    known = metrics.setdefault(name, {"relative": metric, "factor": factor})
    if not isinstance(known, dict) or (known.get("relative"), known.get("factor", 1.0)) != (
        metric,
        factor,
    ):
        raise StudyError(f"is a limit on the metric '{name}', but there is another such", path)
    return name


def _factor_and_offset(text: str, side: str) -> tuple[float, float]:
    """Return a and b of an expression ``a * default + b``.

    Raises
    ------
    StudyError
        If it is no such expression, or a is not above 0.
    """
    expected = "expected a number, or a multiple of the default such as 1.1 * default"
    try:
        of = named_expression(text, (DEFAULT,), "name", side)
    except StudyError as error:
        raise StudyError(f"{expected}; {error.problem}", (side,)) from None
    points = np.array([_HUGE, 0.0, 1.0, -2.0, 7.0])
    with np.errstate(all="ignore"):
        values = np.broadcast_to(of({DEFAULT: points}), points.shape)
        factor, offset = float(values[0] / _HUGE), float(values[1])
        size = abs(offset) + abs(factor * points)
        linear = np.all(np.abs(values - (factor * points + offset)) <= 1e-9 * size)
    if not linear or not 0.0 < factor < np.inf:
        raise StudyError(f"{expected} or default + 0.05, found {checks.quoted(text)}", (side,))
    return checks.magnitude(factor, side), checks.magnitude(offset, side)
