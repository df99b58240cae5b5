"""The searches for all worst-case constraints of one parameter set, which take turns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.study.constraint import Constraint
from bo_tuner.trials import Context, WorstCase
from bo_tuner.worst_case.protocol import WorstCaseSearch


@dataclass(frozen=True)
class ConstraintSearch:
    """A worst-case constraint and the search for its worst context.

    The search maximizes. For a lower limit it observes the negative metric, and its limit is the
    negative of the constraint's.

    Attributes
    ----------
    constraint, search
        The two.
    measured
        Metrics that are measured contexts, which are observed beside the context.
    """

    constraint: Constraint
    search: WorstCaseSearch
    measured: tuple[str, ...] = ()

    def tell(self, context: Context, metrics: Mapping[str, float]) -> None:
        """Add an evaluation: its context and metrics."""
        context = {**context, **{name: metrics[name] for name in self.measured}}
        self.search.tell(context, self.constraint.sign * metrics[self.constraint.metric])

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all evaluations so far, in the metric's unit."""
        sign, worst = self.constraint.sign, self.search.worst_case(rng)
        return replace(worst, value=sign * worst.value, observed=sign * worst.observed)


class WorstCaseSearches:
    """Searches of one parameter set with an ask-and-tell interface.

    Each evaluation informs all searches. One that has ended, since its limit is violated, does not
    end the others: without evaluations of its own, a worst case is underestimated.

    Parameters
    ----------
    searches
        One for each worst-case constraint.
    evaluations
        Largest number of contexts that `ask` returns, for all searches together.
    """

    def __init__(self, searches: Sequence[ConstraintSearch], evaluations: int) -> None:
        self._searches = tuple(searches)
        self._evaluations = evaluations
        self._asked = 0
        self._open = self._searches

    def tell(self, context: Context, metrics: Mapping[str, float]) -> None:
        """Add an evaluation: its context and metrics."""
        for item in self._searches:
            item.tell(context, metrics)

    def done(self, rng: np.random.Generator) -> bool:
        """Return whether all evaluations are used or all searches have ended."""
        if self._asked >= self._evaluations:
            return True
        self._open = tuple(item for item in self._searches if not item.search.done(rng))
        return not self._open

    def ask(self, rng: np.random.Generator) -> Context:
        """Return the next context of the search whose turn it is; call `done` before."""
        item = self._open[self._asked % len(self._open)]
        self._asked += 1
        return item.search.ask(rng)

    def worst_cases(self, rng: np.random.Generator) -> dict[str, WorstCase]:
        """Estimate the worst case for each constraint, by its name."""
        return {item.constraint.name: item.worst_case(rng) for item in self._searches}
