"""What was observed of a parameter set: the evidence that a verdict rests on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan

from bo_tuner.trials import Context

Metrics = Mapping[str, float]


@dataclass(frozen=True)
class WorstMean:
    """The mean of a metric over noise in the worst context that was found.

    Attributes
    ----------
    value, standard_error
        The mean and its standard error, in the metric's unit.
    bound
        Confidence bound of the mean on the side of the limit.
    count
        Number of evaluations.
    """

    value: float
    standard_error: float
    bound: float
    count: int


@dataclass(frozen=True)
class Observed:
    """What was observed of one parameter set.

    Attributes
    ----------
    drawn
        Metrics of the complete evaluations in the draws, by the number of the draw.
    draws
        Number of draws, with the failed ones.
    others
        Metrics of all other complete evaluations of the parameter set on record.
    worst
        By the name of a worst-case constraint, the mean in the worst context, if it was searched.
    paired
        Metrics in the draws that both parameter sets have, if these are not `drawn`.
    contexts
        Of the draws in `drawn`, by their number.
    """

    drawn: Mapping[int, Metrics]
    draws: int
    others: Sequence[Metrics] = ()
    worst: Mapping[str, WorstMean] = field(default_factory=dict)
    paired: Mapping[int, Metrics] | None = None
    contexts: Mapping[int, Context] = field(default_factory=dict)

    @property
    def pairs(self) -> Mapping[int, Metrics]:
        """Metrics in the common draws, by the number of the draw."""
        return self.drawn if self.paired is None else self.paired

    def mean(self, metric: str) -> float:
        """Return the mean of a metric over the draws; NaN without any."""
        values = self.values(metric)
        return sum(values) / len(values) if values else nan

    def values(self, metric: str) -> list[float]:
        """Return the values of a metric in the draws."""
        return [metrics[metric] for metrics in self.drawn.values() if metric in metrics]

    def on_record(self, metric: str) -> list[float]:
        """Return the values of a metric in all evaluations."""
        others = [metrics[metric] for metrics in self.others if metric in metrics]
        return [*self.values(metric), *others]
