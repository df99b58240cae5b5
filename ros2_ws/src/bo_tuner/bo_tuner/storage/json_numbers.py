"""Numbers in JSON, which has no word for those that are not finite: null stands for them."""

import math
from collections.abc import Mapping


def without_nan(value: object) -> object:
    """Replace what is not finite, in a value to be written, by None."""
    if isinstance(value, Mapping):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_number(value: object, missing: float = math.nan) -> float:
    """Return a number that was read; `missing` for None.

    Raises
    ------
    ValueError
        If it is none.
    """
    return missing if value is None else float(str(value))
