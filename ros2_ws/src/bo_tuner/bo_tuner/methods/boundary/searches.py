"""Stage two of `boundary`: by the process of all evaluations."""

from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.methods.searches import ModelSearch
from bo_tuner.models.categories import Coding
from bo_tuner.models.covariates import measured_in, simulated_in
from bo_tuner.models.observations import censored_observations, joint_observations
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.worst_case.pooled_search import KnownRuns, PooledSearch


@dataclass(frozen=True)
class Pooled(ModelSearch):
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
        simulated = self.models.simulation.usual
        kept = [*simulated, *(t for t in trials if t.number not in proposal.outliers)]
        points = space.cube_of(t.parameters for t in kept)
        x, c, y = joint_observations(points, contexts, kept, constraint.metric)
        censored = None
        if constraint.sign > 0.0:
            # The mirror image of a lower limit would be one that the metric stays below.
            censored = censored_observations(points, contexts, kept, constraint.metric)
        # Without context variables, drawn evaluations are those in the worst context.
        idle = contexts.dimension == 0 and proposal.protocol is None
        return PooledSearch(
            contexts,
            space.to_cube(proposal.parameters),
            KnownRuns(
                x,
                c,
                constraint.sign * y,
                Coding(space.levels),
                dict(zip(study.measured, measured_in(study, kept).T, strict=True)),
                censored,
                simulated_in(kept) if simulated else None,
            ),
            limit=constraint.sign * constraint.limit,
            deviations=constraint.deviations,
            evaluations=0 if idle else evaluations,
            models=self.models.of_metric(study, constraint.metric),
            hyperparameters=proposal.hyperparameters.get(constraint.name) or None,
            until_clear=proposal.protocol is None,
        )
