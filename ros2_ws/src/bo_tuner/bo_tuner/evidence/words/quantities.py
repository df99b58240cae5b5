"""What is said of a number of a result."""

from collections.abc import Iterator
from dataclasses import asdict
from math import isfinite, isnan

from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.quantity import DrawsOf, Quantity, ViolationBound
from bo_tuner.evidence.words.limits import as_mapping as limit_as_mapping
from bo_tuner.text import counted, shown, shown_beside
from bo_tuner.trials import DEFAULT, TUNED


def basis(quantity: Quantity) -> str:
    """Return of which runs the numbers are, and of how many test runs each if that differs."""
    kinds = []
    if quantity.estimates is not None:
        default, tuned = quantity.estimates
        one = default.kind == tuned.kind or not default.count
        kinds = [tuned.kind] if one else [f"default by {default.kind}, tuned by {tuned.kind}"]
    return "; ".join((*kinds, *_draws(quantity.draws)))


def change(quantity: Quantity) -> str:
    """Return the change with its interval, in the unit of the quantity."""
    difference = quantity.difference
    if difference is None or not isfinite(difference.mean):
        return "–"
    said = f"{abs(difference.mean):.3g} {'lower' if difference.mean < 0.0 else 'higher'}"
    if not (isfinite(difference.low) and isfinite(difference.high)):
        return said
    if difference.low <= 0.0 <= difference.high:
        said = f"{difference.mean:+.3g}"
    return f"{said} ({difference.interval_in_words})"


def gain(quantity: Quantity) -> str:
    """Return the two values, with the change in percent where that is known."""
    said = f"{quantity.label} {' → '.join(quantity.values_in_words)} {quantity.unit}".rstrip()
    percent = quantity.percent
    return said if isnan(percent) else f"{said} ({percent:+.0f} %)"


def details(quantity: Quantity) -> str:
    """Return what else is known of a limit; empty if nothing is."""
    return "; ".join(_details(quantity))


def _details(quantity: Quantity) -> Iterator[str]:
    found = quantity.limit_verdict
    if found is None:
        return
    if isfinite(quantity.bound):
        yield f"bound of the mean {shown_beside(quantity.bound, quantity.limit)}"
    if quantity.default_unsearched:
        yield "the default has no certified worst case"
    if quantity.violation is not None:
        yield _violation(quantity.violation, found)
    if quantity.on_record is not None:
        farthest = shown_beside(quantity.on_record.value, quantity.limit)
        runs = counted(quantity.on_record.runs, "test run")
        yield f"{found.constraint.extreme} of {runs} on record {farthest}"


def _violation(found: ViolationBound, limit: LimitVerdict) -> str:
    beyond = f"{found.violations} of {counted(found.draws, 'test run')}"
    said = f"{beyond} {limit.constraint.beyond} the limit; probability "
    confidence = f"with {100.0 * found.confidence:g} % confidence"
    at_most = f"at most {found.bound:.3g}"
    if isnan(found.worst):
        return f"{said}{at_most} {confidence}"
    worst = shown_beside(found.worst, found.allowed)
    allowed = shown(found.allowed)
    return (
        f"{said}of a violation {at_most}, and {worst} in the worst contexts, allowed {allowed}, "
        f"{confidence}"
    )


def _draws(draws: DrawsOf | None) -> Iterator[str]:
    if draws is None:
        return
    if draws.both:
        yield f"in the {counted(draws.both, 'test run')} that both completed"
    else:
        yield f"default in {counted(draws.default, 'test run')}, tuned in {draws.tuned}"


def as_mapping(quantity: Quantity) -> dict[str, object]:
    """Return it as it stands in files, with NaN for a number that is not known."""
    item = asdict(quantity)
    del item["on_record"], item["violation"], item["default_unsearched"]
    limits = {
        "limit_verdict": quantity.limit_verdict,
        "default_limit_verdict": quantity.default_limit_verdict,
    }
    estimates = quantity.estimates and {
        side: asdict(estimate)
        for side, estimate in zip((DEFAULT, TUNED), quantity.estimates, strict=True)
    }
    return (
        item
        | {
            "change": str(quantity.change),
            "estimates": estimates,
            "remark": details(quantity),
            "draws": "; ".join(_draws(quantity.draws)),
        }
        | {name: found and limit_as_mapping(found) for name, found in limits.items()}
    )
