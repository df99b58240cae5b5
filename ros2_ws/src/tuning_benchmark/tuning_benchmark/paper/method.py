"""The stages of the paper as a method; its parts are arguments."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule, constrained_improvement
from bo_tuner.methods.contexts import DrawnContexts
from bo_tuner.methods.outlook import Outlook, draws_of_outlook
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.searches import SearchRule, search_evaluations, searches_of
from bo_tuner.models.surrogates import FitSurrogates, Surrogates
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.optimizers.bayesian import (
    AcquisitionSearch,
    BayesianOptimization,
    latest_hyperparameters,
)
from bo_tuner.optimizers.ranking import Ranking
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Trial
from bo_tuner.worst_case.constraint_searches import WorstCaseSearches
from tuning_benchmark.paper.check import CandidateCheck, CheckedAnswer, with_checks
from tuning_benchmark.paper.contexts import FirstContexts
from tuning_benchmark.paper.searches import EachTrial
from tuning_benchmark.paper.trial_models import TrialModels

StageOne = Callable[[Study], Optimizer]
"""Makes an optimizer of stage one."""


@dataclass(frozen=True)
class PaperMethod(Method):
    """A method in two stages, each trial of which is one point for the models.

    Attributes
    ----------
    models
        Fits the surrogates.
    acquisition
        Makes the acquisition function of stage one.
    stage_one
        Makes another optimizer of stage one than Bayesian optimization, whose further gain is not
        estimated.
    contexts
        Of a trial before the search.
    search
        Of stage two.
    searched
        Largest number of evaluations of the search, unless the study says otherwise.
    check
        Of the candidates before the answer.
    """

    models: FitSurrogates[Surrogates] = field(default_factory=TrialModels)
    acquisition: AcquisitionRule = constrained_improvement
    stage_one: StageOne | None = None
    contexts: FirstContexts = field(default=DrawnContexts(5))
    search: SearchRule = field(default_factory=EachTrial)
    searched: int = 10
    check: CandidateCheck = field(default_factory=CandidateCheck)

    @property
    def ranking(self) -> Ranking[Surrogates]:
        """Of the trials, by the surrogates."""
        return Ranking(self.models)

    def problem(self, study: Study) -> str:
        """Refuse measured contexts as well, for which the models of trials have no column."""
        problem = super().problem(study)
        if problem or not study.measured:
            return problem
        return f"knows nothing of what is measured, and the study measures '{study.measured[0]}'"

    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""
        if self.stage_one is not None:
            return self.stage_one(study)
        return BayesianOptimization(study, self.models, self.acquisition)

    def first_contexts(
        self, study: Study, number: int, proposal: Proposal
    ) -> list[tuple[Stage, Context]]:
        """Return the contexts that a trial begins in."""
        return self.contexts.of(study, number, proposal)

    def worst_case_searches(
        self, study: Study, proposal: Proposal, trials: Sequence[Trial]
    ) -> WorstCaseSearches:
        """Make the searches of stage two."""
        most = search_evaluations(study, self.searched)
        return searches_of(self.search, study, proposal, trials, most)

    def outlook(self, study: Study, trials: Sequence[Trial]) -> Outlook | None:
        """Estimate the gain of one more trial by the acquisition function."""
        if self.stage_one is not None:
            return None
        rng = draws_of_outlook(study, trials)
        try:
            surrogates = self.models(study, trials, rng=rng, start=latest_hyperparameters(trials))
            model = surrogates.objective
            if model is None:
                return None
            search = AcquisitionSearch(surrogates, study.search_space(), self.acquisition, rng)
            if search.incumbent is None:
                return None
            maximum = search.maximize()
        except (ArithmeticError, np.linalg.LinAlgError, ValueError):
            return None
        if maximum.log_gain is None:
            return None
        means = model.predict_mean(model.points)
        row = int(np.flatnonzero(search.feasible)[np.argmin(means[search.feasible])])
        noise = float(np.sqrt(model.noise_variance / model.counts[row]))
        return Outlook(search.incumbent, float(np.exp(maximum.log_gain)), noise)

    def answer_search(
        self, study: Study, trials: Sequence[Trial], most: int | None = None
    ) -> CheckedAnswer:
        """Make the search for the answer: checks of candidates, of a fixed number."""
        return self.check.search(study, trials, self.ranking)

    def doubt(self, feasibility: float) -> str:
        """Return why an answer is doubtful."""
        return "It did not pass the check of the best candidates"

    def is_likely(self, feasibility: float, *, checked: bool) -> bool:
        """Return whether it is likely within limits, and no check has said otherwise."""
        return not checked and super().is_likely(feasibility, checked=checked)

    def checked(
        self, study: Study, trials: Sequence[Trial], evaluations: Iterable[Evaluation]
    ) -> list[Trial]:
        """Give trials their checks, with the worst cases that these have estimated."""
        return with_checks(study, trials, evaluations)

    def refusal(
        self, then: Study, now: Study, moved: Sequence[str], unsearched: Sequence[str]
    ) -> str:
        """Refuse what its contexts or its search cannot use."""
        return self.contexts.refusal(then, now, moved) or self.search.refusal(unsearched)

    def hyperparameters(
        self, study: Study, trials: Sequence[Trial], rng: np.random.Generator
    ) -> Mapping[str, tuple[float, ...]]:
        """Return what its search takes from the models."""
        return self.search.hyperparameters(self.models, study, trials, rng)

    def most_evaluations(self, study: Study) -> int:
        """Return the largest number of evaluations of the trials and the checks."""
        each = self.contexts.count(study)
        if study.worst_case_constraints:
            each += search_evaluations(study, self.searched)
        tuning = study.budget.trials * each
        if study.budget.evaluations is not None:
            tuning = min(tuning, study.budget.evaluations + each - 1)
        return tuning + self.check.most_evaluations(study)

    def answer_evaluations(self, study: Study, evaluations: int, made: int) -> int:
        """Return the evaluations of the checks that are expected still."""
        return self.check.expected_evaluations(study, made)
