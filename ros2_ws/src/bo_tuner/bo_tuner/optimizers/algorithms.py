"""The algorithms: I to IV of the paper (Sec. 5.1), and V with a joint model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule, constrained_improvement
from bo_tuner.models.categories import Coding
from bo_tuner.models.surrogates import DEFAULT_MODELS, ModelOptions, joint_observations
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.optimizers.bayesian import BayesianOptimization
from bo_tuner.optimizers.random_search import RandomSearch
from bo_tuner.study.parts import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState
from bo_tuner.worst_case.contexts import worst_contexts_nearby
from bo_tuner.worst_case.joint_search import JointSearch
from bo_tuner.worst_case.protocol import WorstCaseSearch
from bo_tuner.worst_case.search import OBSERVED, POSTERIOR, ReinterpolationSearch
from bo_tuner.worst_case.searches import ConstraintSearch, WorstCaseSearches


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
    neighbour_starts: int = 2
    most_checked: int = 6

    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""
        if self.random:
            return RandomSearch(study)
        return BayesianOptimization(study, self.models, self.acquisition)

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
        return WorstCaseSearches(
            [
                ConstraintSearch(
                    constraint, self.worst_case_search(study, constraint, proposal, trials)
                )
                for constraint in study.worst_case_constraints
            ],
            study.budget.search_evaluations,
        )

    def worst_case_search(
        self, study: Study, constraint: Constraint, proposal: Proposal, trials: Sequence[Trial]
    ) -> WorstCaseSearch:
        """Make the search for one constraint, which is told `Constraint.sign` times its metric."""
        contexts, sign = study.context_space(), constraint.sign
        limit = sign * constraint.limit
        if self.nominal:
            return ReinterpolationSearch(contexts, limit, 0, OBSERVED)
        space = study.search_space()
        coding = Coding(space.levels)
        point = coding.encode(space.to_cube(proposal.parameters)[None])[0]
        if self.models.joint:
            kept = [t for t in trials if t.state is TrialState.COMPLETE]
            points = {t.number: space.to_cube(t.parameters) for t in kept}
            x, y = joint_observations(kept, points, contexts, constraint.metric)
            return JointSearch(
                contexts,
                limit,
                constraint.level,
                study.budget.search_evaluations,
                point,
                coding.encode(x.reshape(-1, space.dimension + contexts.dimension)),
                sign * y,
                proposal.hyperparameters.get(constraint.name) or None,
            )
        name = constraint.name
        known = [(t.parameters, t.worst_cases[name]) for t in trials if name in t.worst_cases]
        return ReinterpolationSearch(
            contexts,
            limit,
            study.budget.search_evaluations,
            self.worst_case,
            worst_contexts_nearby(
                point,
                coding.encode(
                    np.array([space.to_cube(p) for p, _ in known]).reshape(-1, space.dimension)
                ),
                [worst for _, worst in known],
                contexts,
                self.neighbour_starts,
            ),
        )


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
}
