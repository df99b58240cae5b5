"""The headline of a result that may be used: what it gains, and whether the limits are proven."""

from collections.abc import Sequence
from math import isnan

from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.gains import gains
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.verdict import State, Verdict, all_shown
from bo_tuner.evidence.words.limits import in_words as limit_in_words
from bo_tuner.text import counted, shown

AS_BEFORE = "as before"


def gain_in_words(verdict: Verdict) -> str:
    """Return what a result gains over the default, and what is known of its limits, in one line."""
    return f"{_gained(verdict)}; {limits_in_words(verdict)}"


def _gained(verdict: Verdict) -> str:
    if verdict.is_default:
        return "keep the default, no better set was found"
    told = ", ".join(filter(None, map(changed, gains(verdict))))
    if verdict.default_preferred:
        return f"the default has the better objective: {told}"
    if verdict.default_reasons is not None and not verdict.gained:
        return "no gain over the default beyond chance"
    return told or "not compared with the default"


def changed(quantity: Quantity) -> str:
    """Return what has become of a metric; empty if that is not known."""
    difference = quantity.difference
    if quantity.change is Change.NONE:
        return f"{quantity.title} {AS_BEFORE}"
    if difference is None or quantity.change is Change.UNKNOWN:
        return ""
    percent = quantity.percent
    size = f"{shown(difference.mean)} {quantity.unit}".rstrip()
    if not isnan(percent):
        size = f"{percent:+.0f} %"
    elif difference.mean > 0.0:
        size = f"+{size}"
    return f"{quantity.title} {size}{' (worse)' if quantity.change is Change.WORSE else ''}"


def limits_in_words(verdict: Verdict) -> str:
    """Return what is known of all limits of the tuned parameter set, in a few words."""
    found = verdict.limits
    if found and verdict.state is State.CERTIFIED:
        return _proven(found)
    return kept_in_words(found)


def kept_in_words(found: Sequence[LimitVerdict]) -> str:
    """Return what test runs say of all limits of a parameter set that none of them refutes.

    Violations that a limit permits are counted, and a limit is kept only if that is shown.
    """
    if not found:
        return "no limits to keep"
    if all_shown(found):
        return _proven(found)
    beyond = [f"{each.title}: {limit_in_words(each)}" for each in found if each.violations]
    runs = max(each.runs for each in found)
    return "; ".join(beyond) or f"no limit broken in {counted(runs, 'test run')}"


def _proven(found: Sequence[LimitVerdict]) -> str:
    each = {1: "the limit", 2: "both limits"}.get(len(found), f"all {len(found)} limits")
    conditional = any(limit.condition for limit in found)
    return f"{each} {'shown with an assumption' if conditional else 'proven'}"
