"""The contexts that a trial of the paper's algorithms begins in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from bo_tuner.methods.contexts import other_distribution
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Stage


class FirstContexts(Protocol):
    """The contexts that a trial begins in, before the search for the worst one."""

    def of(self, study: Study, number: int, proposal: Proposal) -> list[tuple[Stage, Context]]:
        """Return them for a trial, by its number, each with its stage."""

    def count(self, study: Study) -> int:
        """Return how many they are, unless a proposal says otherwise."""

    def refusal(self, then: Study, now: Study, moved: Sequence[str]) -> str:
        """Return why an earlier run is no data if distributions of contexts have `moved`."""


@dataclass(frozen=True)
class NominalContext:
    """The nominal context alone."""

    def of(self, study: Study, number: int, proposal: Proposal) -> list[tuple[Stage, Context]]:
        """Return the nominal context."""
        contexts = study.context_space()
        return [(Stage.NOMINAL, contexts.to_dict(contexts.nominal()))]

    def count(self, study: Study) -> int:
        """Return 1."""
        return 1

    def refusal(self, then: Study, now: Study, moved: Sequence[str]) -> str:
        """Refuse trials in another nominal context."""
        for name in moved:
            before, after = (s.contexts[name].distribution.nominal for s in (then, now))
            if before != after:
                return other_distribution(name, "runs the nominal context")
        return ""
