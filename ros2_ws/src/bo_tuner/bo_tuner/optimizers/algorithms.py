"""The algorithms: `boundary`, the default; I to IV of the paper (Sec. 5.1); V, a joint model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule, constrained_improvement
from bo_tuner.models.categories import Coding
from bo_tuner.models.fitting import DEFAULT_MODELS, ModelOptions
from bo_tuner.models.observations import joint_observations
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.optimizers.bayesian import BayesianOptimization
from bo_tuner.optimizers.boundary import BoundaryOptimization
from bo_tuner.optimizers.random_search import RandomSearch
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState
from bo_tuner.worst_case.constraint_searches import ConstraintSearch, WorstCaseSearches
from bo_tuner.worst_case.contexts import worst_contexts_nearby
from bo_tuner.worst_case.joint_search import JointSearch
from bo_tuner.worst_case.pooled_search import PooledSearch
from bo_tuner.worst_case.protocol import WorstCaseSearch
from bo_tuner.worst_case.reinterpolation_search import OBSERVED, POSTERIOR, ReinterpolationSearch


@dataclass(frozen=True)
class Algorithm:
    """Choices for the two stages that make up an algorithm.

    Attributes
    ----------
    title
        Short description.
    nominal
        Evaluate each parameter set once, in the nominal context only.
    random
        Draw parameter sets at random instead of by the surrogates.
    models
        Which surrogate models to fit.
    acquisition
        Makes the acquisition function.
    worst_case
        Estimate of the worst case: ``posterior`` or ``observed``, as in `ReinterpolationSearch`.
    drawn_contexts, search_evaluations
        Evaluations of a trial, unless the study says otherwise: in drawn contexts, and at most in
        the search for the worst one.
    neighbour_starts
        Largest number of starting contexts of a worst-case search, which are the worst contexts of
        neighbouring trials.
    most_checked
        Largest number of candidates to check on fresh draws before the recommendation.
    """

    title: str
    nominal: bool = False
    random: bool = False
    models: ModelOptions = DEFAULT_MODELS
    acquisition: AcquisitionRule = constrained_improvement
    worst_case: str = POSTERIOR
    drawn_contexts: int = 5
    search_evaluations: int = 10
    neighbour_starts: int = 2
    most_checked: int = 6

    @property
    def one_objective(self) -> bool:
        """Whether it cannot optimize several objectives."""
        return self.models.pooled

    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""
        if self.random:
            return RandomSearch(study)
        if self.models.pooled:
            return BoundaryOptimization(study, self.models, self.acquisition)
        return BayesianOptimization(study, self.models, self.acquisition)

    def protocol(self, study: Study, proposal: Proposal) -> tuple[int, int]:
        """Return the evaluations of a trial: in drawn contexts, and at most in the search."""
        return self.evaluations(study) if proposal.protocol is None else proposal.protocol

    def evaluations(self, study: Study) -> tuple[int, int]:
        """Return `protocol` where a proposal does not say otherwise."""
        drawn, searched = study.budget.drawn_contexts, study.budget.search_evaluations
        return (
            self.drawn_contexts if drawn is None else drawn,
            self.search_evaluations if searched is None else searched,
        )

    def worst_case_searches(
        self, study: Study, proposal: Proposal, trials: Sequence[Trial]
    ) -> WorstCaseSearches:
        """Make the worst-case searches of stage two for a proposed parameter set.

        Parameters
        ----------
        study
            The study.
        proposal
            The proposed parameter set.
        trials
            All trials so far.
        """
        searches = [
            ConstraintSearch(
                constraint, self.worst_case_search(study, constraint, proposal, trials)
            )
            for constraint in study.worst_case_constraints
        ]
        return WorstCaseSearches(searches, self.protocol(study, proposal)[1])

    def worst_case_search(
        self, study: Study, constraint: Constraint, proposal: Proposal, trials: Sequence[Trial]
    ) -> WorstCaseSearch:
        """Make the search for one constraint, which is told `Constraint.sign` times its metric."""
        if self.models.pooled:
            return self._pooled_search(study, constraint, proposal, trials)
        if self.models.joint:
            return self._joint_search(study, constraint, proposal, trials)
        return self._reinterpolation_search(study, constraint, proposal, trials)

    def _pooled_search(
        self, study: Study, constraint: Constraint, proposal: Proposal, trials: Sequence[Trial]
    ) -> PooledSearch:
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
            0 if idle else self.protocol(study, proposal)[1],
            space.to_cube(proposal.parameters),
            x,
            c,
            constraint.sign * y,
            Coding(space.levels),
            proposal.hyperparameters.get(constraint.name) or None,
            until_clear=proposal.protocol is None,
        )

    def _joint_search(
        self, study: Study, constraint: Constraint, proposal: Proposal, trials: Sequence[Trial]
    ) -> JointSearch:
        contexts, space = study.context_space(), study.search_space()
        coding = Coding(space.levels)
        kept = [
            t
            for t in trials
            if t.state is TrialState.COMPLETE and t.number not in proposal.outliers
        ]
        points = space.cube_of(t.parameters for t in kept)
        x, c, y = joint_observations(points, contexts, kept, constraint.metric)
        return JointSearch(
            contexts,
            constraint.sign * constraint.limit,
            constraint.level,
            self.protocol(study, proposal)[1],
            coding.encode(space.to_cube(proposal.parameters)[None])[0],
            coding.encode(np.hstack([x, c])),
            constraint.sign * y,
            proposal.hyperparameters.get(constraint.name) or None,
        )

    def _reinterpolation_search(
        self, study: Study, constraint: Constraint, proposal: Proposal, trials: Sequence[Trial]
    ) -> ReinterpolationSearch:
        contexts, space = study.context_space(), study.search_space()
        limit = constraint.sign * constraint.limit
        if self.nominal:
            return ReinterpolationSearch(contexts, limit, 0, OBSERVED)
        coding = Coding(space.levels)
        name = constraint.name
        known = [(t.parameters, t.worst_cases[name]) for t in trials if name in t.worst_cases]
        return ReinterpolationSearch(
            contexts,
            limit,
            self.protocol(study, proposal)[1],
            self.worst_case,
            worst_contexts_nearby(
                coding.encode(space.to_cube(proposal.parameters)[None])[0],
                coding.encode(space.cube_of(p for p, _ in known)),
                [worst for _, worst in known],
                contexts,
                self.neighbour_starts,
            ),
        )


BOUNDARY = "boundary"
DEFAULT_ALGORITHM = BOUNDARY
SEVERAL_OBJECTIVES = "IV"
"""The default for a study with several objectives."""

ALGORITHMS = {
    "I": Algorithm("Bayesian optimization on the nominal model", nominal=True, most_checked=0),
    "II": Algorithm("random sampling in stage one", random=True),
    "III": Algorithm(
        "Bayesian optimization without outlier detection",
        models=ModelOptions(reject_outliers=False),
    ),
    "IV": Algorithm("Bayesian optimization with outlier detection"),
    "V": Algorithm(
        "as IV, with one joint model of parameter set and context",
        models=ModelOptions(joint=True),
    ),
    BOUNDARY: Algorithm(
        "search, then repeated runs at the boundary of the limits, all pooled in one joint model",
        models=ModelOptions(pooled=True),
        drawn_contexts=2,
        search_evaluations=3,
        most_checked=0,
    ),
}


def default_algorithm(study: Study) -> str:
    """Return the algorithm for a study when none is chosen."""
    return SEVERAL_OBJECTIVES if len(study.objectives) > 1 else DEFAULT_ALGORITHM


def several_objectives_problem(algorithm: str, study: Study) -> str:
    """Return in one line why an algorithm cannot run a study; empty if it can."""
    if len(study.objectives) == 1 or not ALGORITHMS[algorithm].one_objective:
        return ""
    others = ", ".join(name for name, item in ALGORITHMS.items() if not item.one_objective)
    return (
        f"{algorithm} optimizes one objective, and the study has {len(study.objectives)}; expected "
        f"one of {others}"
    )
