"""How a method searches for the worst context of a parameter set."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from bo_tuner.models.surrogates import FitSurrogates, Surrogates
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.worst_case.constraint_searches import ConstraintSearch, WorstCaseSearches
from bo_tuner.worst_case.protocol import WorstCaseSearch


class SearchRule(Protocol):
    """Makes the searches for the worst context of a proposed parameter set.

    A subclass needs `__call__` alone.
    """

    def __call__(
        self,
        study: Study,
        constraint: Constraint,
        proposal: Proposal,
        trials: Sequence[Trial],
        evaluations: int,
    ) -> WorstCaseSearch:
        """Make the search for one constraint; it observes `Constraint.sign` times the metric.

        Parameters
        ----------
        study
            The study.
        constraint
            On the worst case.
        proposal
            The proposed parameter set.
        trials
            All trials so far.
        evaluations
            Largest number of contexts that it asks for.
        """

    def unusable(self, unsearched: Sequence[str]) -> str:
        """Return why an earlier run is no data without the search for these constraints."""
        if not unsearched:
            return ""
        return (
            f"the worst case of constraints.{unsearched[0]} was not searched for in this run, and "
            "its algorithm searches for it in each trial"
        )

    def hyperparameters(
        self,
        models: FitSurrogates[Surrogates],
        study: Study,
        trials: Sequence[Trial],
        rng: np.random.Generator,
    ) -> Mapping[str, tuple[float, ...]]:
        """Return what it takes from the models of a method, by the names of the models."""
        return {}


class ModelSearch(SearchRule):
    """A search by a model of all trials, which estimates the worst case of any of them."""

    def unusable(self, unsearched: Sequence[str]) -> str:
        """Refuse nothing: the model estimates worst cases that were not searched for."""
        return ""

    def hyperparameters(
        self,
        models: FitSurrogates[Surrogates],
        study: Study,
        trials: Sequence[Trial],
        rng: np.random.Generator,
    ) -> Mapping[str, tuple[float, ...]]:
        """Return those of the models."""
        return models(study, trials, rng=rng).warm_starts


def searches_of(
    rule: SearchRule, study: Study, proposal: Proposal, trials: Sequence[Trial], evaluations: int
) -> WorstCaseSearches:
    """Make the searches for all worst-case constraints, of a trial that is proposed.

    `evaluations` is the largest number of contexts that they ask for together.
    """
    searches = [
        ConstraintSearch(
            constraint, rule(study, constraint, proposal, trials, evaluations), study.measured
        )
        for constraint in study.worst_case_constraints
    ]
    return WorstCaseSearches(searches, evaluations)


def search_evaluations(study: Study, usual: int) -> int:
    """Return the evaluations of a search: what the study says, or else as `usual`."""
    declared = study.budget.search_evaluations
    return usual if declared is None else declared
