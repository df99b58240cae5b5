"""What metrics of a distance between signals have in common."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.rules import Expected
from bo_tuner.errors import StudyError
from bo_tuner.numerics.signal_metrics import MEASURES, SYNONYMS, options_of
from bo_tuner.study.measures import check_measure
from bo_tuner.study.metric_keys import ScaledMetricKeys
from bo_tuner.study.signals import Signal

_COORDINATES = "two or three signals, as [x, y]"


def _two_or_three(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) not in (2, 3):
        raise StudyError(f"expected {_COORDINATES}, found {checks.show(names)}")
    return names


Coordinates = Annotated[tuple[str, ...], Expected(_COORDINATES), _two_or_three]
"""Signals that are the coordinates of a position, x and y or x, y and z [m]."""


@dataclass(frozen=True, kw_only=True)
class DistanceMetric(ScaledMetricKeys, ABC):
    """A number that is computed from a distance over the time of a run.

    Attributes
    ----------
    measure : str
        What is computed from the distance, such as `rms`, `maximum` or `percentile`.
    percent : float, optional
        Percentage of the time in which `percentile` is not exceeded, 0 to 100.
    """

    measure: str
    unit: str = "m"
    percent: float | None = None

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False

    def __post_init__(self) -> None:
        super().__post_init__()
        # None has a target.
        of_distance = [name for name in MEASURES if not options_of(name).get("target")]
        known = [*of_distance, *(s for s, name in SYNONYMS.items() if name in of_distance)]
        checks.choice(self.measure, known, "measure")
        check_measure(self)

    @property
    @abstractmethod
    def signals(self) -> tuple[str, ...]:
        """Names of all signals that it needs."""

    @abstractmethod
    def check_signals(self, signals: Collection[str]) -> None:
        """Refuse signals that the study does not have."""

    @abstractmethod
    def check_kinds(self, signals: Mapping[str, Signal]) -> None:
        """Refuse whole messages where it needs numbers, and the other way round."""
