"""What the loop asks of a search of the worst context."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from bo_tuner.trials import WorstCase


class WorstCaseSearch(Protocol):
    """Searches the context in which one parameter set does worst, by ask and tell.

    What it asks for depends on what it was told and on the generators alone, so that a run can be
    resumed.
    """

    def tell(self, context: Mapping[str, float], value: float) -> None:
        """Take note of an evaluation: its context and the constrained metric."""

    def done(self, rng: np.random.Generator) -> bool:
        """Whether nothing is left to ask."""

    def ask(self, rng: np.random.Generator) -> dict[str, float]:
        """Give the next context to evaluate."""

    def worst_case(self, rng: np.random.Generator) -> WorstCase:
        """Estimate the worst case from all that was told."""
