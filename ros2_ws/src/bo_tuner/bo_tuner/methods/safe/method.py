"""The method `safe`: as `boundary`, but it tries only what it expects to be safe."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from bo_tuner.methods.boundary.judging import PooledRanking
from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.safe.stage_one import SafeOptimization
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.optimizers.base import DEFAULT, START, Optimizer, Proposal
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import broken_limits, kept_by
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Outcome, Stage, Trial, Value, parameter_set

MOST_CORNERS = 8
"""Largest number of corners of the contexts in all of which a parameter set to start from is run.

Of more of them, so many are taken evenly.
"""


@dataclass(frozen=True)
class KeptRanking(PooledRanking):
    """Ranks only parameter sets all runs of which kept their limits.

    No others are run again in the search for the answer, or are one.
    """

    def ranked_by(  # noqa: D102
        self, models: Surrogates, study: Study, trials: Sequence[Trial]
    ) -> list[Candidate]:
        return super().ranked_by(models, study, _ranked(study, trials))

    def first_by(  # noqa: D102
        self, models: Surrogates, study: Study, trials: Sequence[Trial]
    ) -> Candidate | None:
        return super().first_by(models, study, _ranked(study, trials))


def _ranked(study: Study, trials: Sequence[Trial]) -> Sequence[Trial]:
    kept = {trial.parameter_set for trial in kept_by(study, trials)}
    return [trial for trial in trials if trial.parameter_set in kept]


@dataclass(frozen=True)
class Safe(Boundary):
    """A search that tries only parameter sets that it expects to be safe; see `stage_one`."""

    # What a run kept until it was cut short says nothing of what the whole one does.
    cuts_short: ClassVar[bool] = False
    # What is safe on the machine is to be known from the machine alone.
    takes_simulations: ClassVar[bool] = False
    takes_priors: ClassVar[bool] = False

    @property
    def ranking(self) -> PooledRanking:
        """Of the parameter sets that have kept their limits, by the models of all evaluations."""
        return KeptRanking(self.models)

    def problem(self, study: Study) -> str:
        """Refuse a study without a limit as well."""
        problem = super().problem(study)
        if problem or study.constraints:
            return problem
        return "needs a limit to keep, and the study has none"

    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""
        return SafeOptimization(study, self.ranking, self.acquisition)

    def first_contexts(
        self, study: Study, number: int, proposal: Proposal
    ) -> list[tuple[Stage, Context]]:
        """Return the contexts that a trial begins in: one to start from is run in corners, too."""
        first = super().first_contexts(study, number, proposal)
        if proposal.origin not in (DEFAULT, START) or not study.worst_case_constraints:
            return first
        contexts = study.context_space()
        corners = contexts.corners()
        corners = corners[:: -(-len(corners) // MOST_CORNERS)]
        rows = contexts.to_contexts(corners) if study.contexts else corners[:0]
        return [*first, *((Stage.SEARCH, contexts.to_dict(row)) for row in rows)]

    def ends_trial(self, study: Study, outcome: Outcome) -> bool:
        """Return whether a run broke a limit: there is no need to break it again."""
        return bool(broken_limits(study, outcome))

    def runs_again(
        self, study: Study, trials: Sequence[Trial], parameters: Mapping[str, Value]
    ) -> bool:
        """Return whether a parameter set was tried, and has kept all limits in its runs."""
        return parameter_set(parameters) in {t.parameter_set for t in kept_by(study, trials)}

    def most_evaluations(self, study: Study) -> int:
        """Return the largest number of evaluations, those of the starts in the corners included."""
        corners = len(study.context_space().corners()) if study.contexts else 0
        starts = min(corners, MOST_CORNERS) * max(len(study.start), 1)
        return super().most_evaluations(study) + starts
