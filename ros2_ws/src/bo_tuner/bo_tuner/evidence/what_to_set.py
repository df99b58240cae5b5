"""What to set, in one line: the values, whether they keep the limits, the objective, and trust."""

from collections.abc import Mapping
from math import isfinite

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.verdict import Quantity, State, Verdict
from bo_tuner.study.study import Study
from bo_tuner.text import shown
from bo_tuner.trials import Value

MOST_VALUES = 4
"""Values that are named in the line; more stand below it."""


def what_to_set(study: Study, verdict: Verdict, parameters: Mapping[str, Value]) -> str:
    """Return what to set in one line.

    Parameters
    ----------
    study, verdict
        The study, and the verdict on the result of its run, or on what it has so far.
    parameters
        The parameter set that the verdict is on; empty without one.
    """
    match verdict.state:
        case State.OPEN | State.INCOMPLETE:
            best = f". Best so far: {_values(study, parameters)}" if parameters else ""
            return f"{verdict.headline}{best}"
        case _ if verdict.trial is None:
            return verdict.headline
        case State.INFEASIBLE:
            if verdict.default_unrefuted and not verdict.is_default:
                return f"Keep the default. {verdict.headline}"
            return f"{verdict.headline}: do not set {_values(study, parameters)}"
        case State.UNPROVEN:
            return f"{verdict.headline}. Likeliest so far: {_values(study, parameters)}"
        case State.REFUSED:
            return f"Do not set {_values(study, parameters)}. {verdict.headline}"
    remarks = [verdict.limits_in_words, *map(_objective, _objectives(verdict)), verdict.trust]
    remarks += [f"{each.parameter} at its {each.side} bound" for each in verdict.at_bounds]
    if verdict.is_default:
        first = "Keep the default"
    elif verdict.default_preferred:
        first = f"Keep the default, which has the better objective. {_values(study, parameters)}"
    elif verdict.default_reasons is not None and not verdict.gained:
        values = _values(study, parameters)
        first = f"Keep the default, from which {values} cannot be told apart"
    else:
        first = f"Set {_values(study, parameters)}"
    return f"{first}: {', '.join(filter(None, remarks))}"


def _values(study: Study, parameters: Mapping[str, Value]) -> str:
    tuned = [name for name, item in study.parameters.items() if item.is_tuned]
    if len(tuned) > MOST_VALUES:
        return f"the {len(tuned)} values below"
    return ", ".join(f"{name} {shown(parameters[name])}" for name in tuned)


def _objectives(verdict: Verdict) -> list[Quantity]:
    return [] if verdict.is_default else [q for q in verdict.quantities if q.objective]


def _objective(quantity: Quantity) -> str:
    """Return what has become of an objective; empty if that is not known."""
    match quantity.change:
        case Change.NONE:
            return f"{quantity.title} unchanged"
        case Change.UNKNOWN:
            return ""
    difference = quantity.difference
    if difference is None or not isfinite(difference.mean):
        return ""
    side = "lower" if difference.mean < 0.0 else "higher"
    size = f"{shown(abs(difference.mean))} {quantity.unit}".rstrip()
    if quantity.default > 0.0:
        size = f"{100.0 * abs(difference.mean) / quantity.default:.0f} %"
    worse = " (worse)" if quantity.change is Change.WORSE else ""
    return f"{quantity.title} {size} {side}{worse}"
