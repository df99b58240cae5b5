"""What a single run of a parameter set shows: its metrics beside the limits."""

from collections.abc import Iterator
from dataclasses import dataclass

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.text import counted, shown, shown_beside
from bo_tuner.trials import Evaluation

WITHIN, BEYOND = "within", "BEYOND"


@dataclass(frozen=True)
class Row:
    """A metric of the run, beside one of its limits if it has any; all as text."""

    metric: str
    unit: str
    value: str
    limit: str = ""
    standing: str = ""


@dataclass(frozen=True)
class SingleRun:
    """A run, and what it says of the limits: of a limit on many runs, what this one adds.

    Attributes
    ----------
    study
        The study.
    evaluation
        The run, with its outcome.
    """

    study: Study
    evaluation: Evaluation

    @property
    def beyond(self) -> tuple[Constraint, ...]:
        """The limits that the run is beyond."""
        metrics = self.evaluation.outcome.metrics
        limits = self.study.constraints.values() if self.evaluation.outcome.complete else ()
        return tuple(limit for limit in limits if limit.violations(metrics[limit.metric]))

    @property
    def within(self) -> bool:
        """Whether the run is complete, and beyond no limit."""
        return self.evaluation.outcome.complete and not self.beyond

    @property
    def headline(self) -> str:
        """What came out, in a line."""
        outcome, count = self.evaluation.outcome, len(self.study.constraints)
        if not outcome.complete:
            return f"the run is {outcome.state}: {outcome.reason}"
        if not count:
            return "the run is complete; the study has no limits"
        if self.beyond:
            names = ", ".join(map(self.study.limit_title, self.beyond))
            return f"this run is beyond {len(self.beyond)} of {counted(count, 'limit')}: {names}"
        return f"this run is within its {'limit' if count == 1 else f'{count} limits'}"

    def rows(self) -> Iterator[Row]:
        """Yield the metrics in the order of the study, one with two limits in two rows."""
        metrics = self.evaluation.outcome.metrics
        for name, metric in self.study.metrics.items():
            if name not in metrics:
                continue
            limits = [item for item in self.study.constraints.values() if item.metric == name]
            for limit in limits:
                yield Row(
                    metric.title,
                    metric.unit,
                    shown_beside(metrics[name], limit.limit),
                    f"{'≤' if limit.sign > 0.0 else '≥'} {limit.limit:.4g}",
                    BEYOND if limit in self.beyond else WITHIN,
                )
            if not limits:
                yield Row(metric.title, metric.unit, shown(metrics[name]))
