"""What a metric measures of a signal: the name of the measure, and its options."""

from typing import Any

from bo_tuner.codec import checks
from bo_tuner.codec.rules import POSITIVE
from bo_tuner.errors import StudyError
from bo_tuner.numerics.signal_metrics import MEASURES, SYNONYMS, options_of

OPTIONS = ("target", "percent", "band")


def check_measure(metric: Any) -> None:
    """Refuse the `measure` of a frozen metric, or its options, if it has them, and settle them.

    Raises
    ------
    StudyError
        If there is no such measure, or an option is missing, too many or no number.
    """
    checks.choice(metric.measure, (*MEASURES, *SYNONYMS), "measure")
    object.__setattr__(metric, "measure", SYNONYMS.get(metric.measure, metric.measure))
    options = options_of(metric.measure)
    for key in OPTIONS:
        value = getattr(metric, key, None)
        if value is None and options.get(key):
            raise StudyError(f"missing; {metric.measure} needs one", (key,))
        if value is not None and key not in options:
            raise StudyError(f"{metric.measure} has none", (key,))
        if value is not None and not (key == "target" and isinstance(value, str)):
            object.__setattr__(metric, key, checks.magnitude(value, key))
    percent = getattr(metric, "percent", None)
    if percent is not None and not 0.0 <= percent <= 100.0:
        raise StudyError(f"expected 0 to 100, found {percent:g}", ("percent",))
    if getattr(metric, "band", None) is not None:
        POSITIVE(metric.band, "band")
