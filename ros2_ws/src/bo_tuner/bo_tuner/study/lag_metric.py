"""By how much a signal is behind another one, as a metric of a study."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.rules import POSITIVE
from bo_tuner.study.metric_keys import MetricKeys
from bo_tuner.study.signals import Signal, only_numbers


@dataclass(frozen=True, kw_only=True)
class LagMetric(MetricKeys):
    """A time by which a signal is behind another one: where they correlate most.

    Take signals that vary, as a speed or a turn rate does; of a steady way nobody can tell.

    Attributes
    ----------
    lag : str
        The signal that is late, such as the estimate.
    behind : str
        The signal that it follows, such as the truth.
    most : float
        Longest time [s] that is looked for, in both directions.
    unit : str
        Unit, for display only.
    """

    lag: str
    behind: str
    most: Annotated[float, POSITIVE] = 1.0
    unit: str = "s"

    scale = "linear"
    """It may be negative, and so has no logarithm."""

    reproducible = False
    """Of measured signals no two runs give the same."""

    measures_time = False
    """Of the signals alone: what the computer is busy with does not matter by itself."""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals that it needs."""
        return self.lag, self.behind

    def check_signals(self, signals: Collection[str]) -> None:
        """Refuse signals that the study does not have."""
        checks.reference(self.lag, "signal", signals, "lag")
        checks.reference(self.behind, "signal", signals, "behind")

    def check_kinds(self, signals: Mapping[str, Signal]) -> None:
        """Refuse signals that are no numbers."""
        only_numbers(self.lag, signals, "lag")
        only_numbers(self.behind, signals, "behind")
