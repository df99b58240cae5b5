"""Stage two of `boundary`: by the process of all evaluations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.methods.searches import SearchRule
from bo_tuner.models.categories import Coding
from bo_tuner.models.covariates import measured_in
from bo_tuner.models.observations import joint_observations
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.models.surrogates import FitSurrogates, Surrogates
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.worst_case.pooled_search import PooledSearch


@dataclass(frozen=True)
class Pooled(SearchRule):
    """A search by the process of all evaluations.

    Attributes
    ----------
    models
        Say which kind of process, and on which scale.
    """

    models: PooledModels

    def __call__(
        self,
        study: Study,
        constraint: Constraint,
        proposal: Proposal,
        trials: Sequence[Trial],
        evaluations: int,
    ) -> PooledSearch:
        """Make the search for one constraint."""
        contexts, space = study.context_space(), study.search_space()
        kept = [t for t in trials if t.number not in proposal.outliers]
        points = space.cube_of(t.parameters for t in kept)
        x, c, y = joint_observations(points, contexts, kept, constraint.metric)
        # Without context variables, drawn evaluations are those in the worst context.
        idle = contexts.dimension == 0 and proposal.protocol is None
        return PooledSearch(
            contexts,
            constraint.sign * constraint.limit,
            constraint.deviations,
            0 if idle else evaluations,
            space.to_cube(proposal.parameters),
            x,
            c,
            constraint.sign * y,
            Coding(space.levels),
            proposal.hyperparameters.get(constraint.name) or None,
            models=self.models.of_metric(study, constraint.metric),
            until_clear=proposal.protocol is None,
            measured=dict(zip(study.measured, measured_in(study, kept).T, strict=True)),
        )

    def unusable(self, unsearched: Sequence[str]) -> str:
        """Refuse nothing: the process estimates the worst case of any trial."""
        return ""

    def hyperparameters(
        self,
        models: FitSurrogates[Surrogates],
        study: Study,
        trials: Sequence[Trial],
        rng: np.random.Generator,
    ) -> Mapping[str, tuple[float, ...]]:
        """Return those of the processes."""
        return models(study, trials, rng=rng).warm_starts
