"""Interface of the worst-case searches of stage two."""

from typing import Protocol

import numpy as np

from bo_tuner.trials import Context, WorstCase


class WorstCaseSearch(Protocol):
    """Search of the worst context of one parameter set, with an ask-and-tell interface.

    The contexts depend only on the evaluations passed to `tell` and on the generators, so a run can
    be resumed.
    """

    def tell(self, context: Context, value: float) -> None:
        """Add an evaluation: its context, with the measured ones, and the constrained metric."""

    def done(self, rng: np.random.Generator) -> bool:
        """Return whether the search has ended."""

    def ask(self, rng: np.random.Generator) -> Context:
        """Return the next context to evaluate."""

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all evaluations so far."""
