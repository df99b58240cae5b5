"""The keys that metrics of all kinds have."""

from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.rules import KEY, Expected, OneOf
from bo_tuner.errors import StudyError
from bo_tuner.study.parts import LINEAR, LOG
from bo_tuner.study.titles import Label, Titled

Number = Annotated[float, checks.magnitude]
Range = tuple[float, float]


def _increasing(ends: Range) -> Range:
    low, high = ends
    if not low < high:
        raise StudyError(f"expected low < high, found [{low:g}, {high:g}]")
    return ends


@dataclass(frozen=True, kw_only=True)
class MetricKeys(Titled):
    """What a metric of any kind has.

    Attributes
    ----------
    name : str
        Name in the study.
    label : str
        What screens call it in place of its name, such as ``solve time (p99)``.
    unit : str
        Unit, for display only.
    range : tuple of float, optional
        The smallest and the largest value, in `unit`, that any run can have. A certificate shows a
        limit on a mean by it, whatever the noise is.
    """

    name: Annotated[str, KEY, checks.parameter_name]
    label: Label = ""
    unit: str = ""
    range: (
        Annotated[tuple[Number, Number], Expected("two numbers, as [low, high]"), _increasing]
        | None
    ) = None


@dataclass(frozen=True, kw_only=True)
class ScaledMetricKeys(MetricKeys):
    """What a metric has that may be positive.

    Attributes
    ----------
    scale : str
        How it is modelled if it is limited: `linear` as it is, or `log` for a positive metric that
        varies in proportion.
    """

    scale: Annotated[str, OneOf((LINEAR, LOG))] = LINEAR
