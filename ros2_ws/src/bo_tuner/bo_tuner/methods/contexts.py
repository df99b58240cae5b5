"""The contexts that a trial begins in."""

from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Stage


@dataclass(frozen=True)
class DrawnContexts:
    """Contexts drawn from their distribution.

    Attributes
    ----------
    drawn
        How many, unless the study says otherwise, or a second run tells nothing.
    """

    drawn: int

    def of(self, study: Study, number: int, proposal: Proposal) -> list[tuple[Stage, Context]]:
        """Draw them, as many as the proposal or the study says."""
        contexts, rng = study.context_space(), generator(study.seed, Stream.CONTEXTS, number)
        count = self.count(study) if proposal.protocol is None else proposal.protocol[0]
        drawn = contexts.draw_stratified(count, rng)
        return [(Stage.DRAWN, contexts.to_dict(row)) for row in drawn]

    def count(self, study: Study) -> int:
        """Return the number that the study says, or else `drawn`; 1 where a run tells all."""
        declared = study.budget.drawn_contexts
        if declared is not None:
            return declared
        return 1 if study.a_run_tells_all else self.drawn

    def refusal(self, then: Study, now: Study, moved: Sequence[str]) -> str:
        """Refuse trials with means over another distribution."""
        return other_distribution(moved[0], "takes means over random contexts") if moved else ""


def other_distribution(name: str, what: str) -> str:
    """Return that a context variable has moved, and what an algorithm does that forbids it."""
    return f"contexts.{name} has another distribution, and the algorithm of this run {what}"
