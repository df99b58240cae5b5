"""What was observed of a parameter set: the evidence that a verdict rests on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bo_tuner.evidence.estimates import Estimate, Source, of_draws
from bo_tuner.study.context_space import ContextSpace
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
    beside
        What was observed of it in the draws of the other parameter set, if these are not `drawn`.
    contexts
        Of the draws in `drawn`, by their number.
    source
        Whose draws they are.
    """

    drawn: Mapping[int, Metrics]
    draws: int
    others: Sequence[Metrics] = ()
    worst: Mapping[str, WorstMean] = field(default_factory=dict)
    beside: "Observed | None" = None
    contexts: Mapping[int, Context] = field(default_factory=dict)
    source: Source = Source.VALIDATION

    def estimate(self, metric: str, space: ContextSpace) -> Estimate:
        """Return the estimate of the mean of a metric by the draws."""
        values = {k: metrics[metric] for k, metrics in self.drawn.items() if metric in metrics}
        return of_draws(values, self.contexts, self.draws, space, self.source)

    def values(self, metric: str) -> list[float]:
        """Return the values of a metric in the draws."""
        return [metrics[metric] for metrics in self.drawn.values() if metric in metrics]

    def on_record(self, metric: str) -> list[float]:
        """Return the values of a metric in all evaluations."""
        others = [metrics[metric] for metrics in self.others if metric in metrics]
        return [*self.values(metric), *others]
