"""The method `boundary`; its parts are arguments."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule, constrained_improvement
from bo_tuner.errors import StudyError
from bo_tuner.methods.boundary.approach import Approach
from bo_tuner.methods.boundary.exploration import Exploration
from bo_tuner.methods.boundary.judging import OwnRanking, PooledRanking
from bo_tuner.methods.boundary.repetition import OwnRuns
from bo_tuner.methods.boundary.searches import Pooled
from bo_tuner.methods.boundary.settling import (
    Repetitions,
    SettledAnswer,
    with_all_repetitions,
    with_known_repetitions,
)
from bo_tuner.methods.boundary.stage_one import (
    AdaptedAvoidance,
    Avoidance,
    BoundaryOptimization,
    Schedule,
    new_point,
    provable,
)
from bo_tuner.methods.contexts import DrawnContexts
from bo_tuner.methods.outlook import Outlook, draws_of_outlook
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.searches import SearchRule, search_evaluations, searches_of
from bo_tuner.models.estimates import estimated
from bo_tuner.models.pooled_models import PooledModels, PooledSurrogates
from bo_tuner.models.simulation import Simulation
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.optimizers.base import Optimizer, Proposal
from bo_tuner.optimizers.bayesian import AcquisitionSearch, latest_hyperparameters, leaves_gaps
from bo_tuner.study.study import Study
from bo_tuner.text import percent
from bo_tuner.trials import (
    Context,
    Evaluation,
    EvaluationState,
    Stage,
    Trial,
    count_checks,
    count_evaluations,
)
from bo_tuner.worst_case.constraint_searches import WorstCaseSearches

MOST_TO_SETTLE = 25
"""Repetitions after which the answer is settled, if they are not used up before.

How many it takes differs widely between runs, and hardly depends on how many are allowed.
"""


@dataclass(frozen=True)
class Boundary(Method):
    """Search, then settle which side of the limits the best points are on.

    Attributes
    ----------
    models
        Fits the models of all evaluations.
    acquisition
        Makes the acquisition function of stage one.
    schedule
        Says which trials are a search.
    ahead
        Further runs of a new point after which it should be shown to keep its limits.
    avoidance
        Largest probability of a failure of a proposal.
    exploration
        Which trials may look elsewhere than where improvement is expected.
    approach
        Where a first feasible parameter set is searched.
    contexts
        Of a trial before the search.
    search
        Of stage two; by default one by the process of the models.
    searched
        Largest number of evaluations of the search in a trial, unless the study says otherwise.
    repetitions
        How many there are.
    own_runs
        Runs of its own that the answer must have.
    """

    cuts_short: ClassVar[bool] = True
    takes_simulations: ClassVar[bool] = True
    takes_priors: ClassVar[bool] = True

    models: PooledModels = field(default_factory=PooledModels)
    acquisition: AcquisitionRule = constrained_improvement
    schedule: Schedule = field(default_factory=Schedule)
    ahead: int = 8
    avoidance: Avoidance = field(default_factory=AdaptedAvoidance)
    exploration: Exploration = field(default_factory=Exploration)
    approach: Approach = field(default_factory=Approach)
    contexts: DrawnContexts = field(default=DrawnContexts(2))
    search: SearchRule | None = None
    searched: int = 3
    repetitions: Repetitions = field(default_factory=Repetitions)
    own_runs: OwnRuns = field(default_factory=OwnRuns)

    @property
    def ranking(self) -> PooledRanking:
        """Of the parameter sets, by the models of all evaluations."""
        return PooledRanking(self.models)

    @property
    def _search(self) -> SearchRule:
        return self.search or Pooled(self.models)

    def optimizer(self, study: Study) -> Optimizer:
        """Make the optimizer of stage one."""
        return BoundaryOptimization(
            study,
            self.ranking,
            self.acquisition,
            self.schedule,
            self.ahead,
            self.avoidance,
            self.exploration,
            self.approach,
        )

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
        if proposal.protocol is not None:
            _, most = proposal.protocol
        return searches_of(self._search, study, proposal, trials, most)

    def outlook(self, study: Study, trials: Sequence[Trial]) -> Outlook | None:
        """Estimate the gain of one more trial: that it will be shown to be better."""
        rng = draws_of_outlook(study, trials)
        try:
            models = self.models(study, trials, rng=rng, start=latest_hyperparameters(trials))
            return self._outlook(study, trials, models, rng)
        except (ArithmeticError, np.linalg.LinAlgError, ValueError):
            return None

    def _outlook(
        self,
        study: Study,
        trials: Sequence[Trial],
        models: PooledSurrogates,
        rng: np.random.Generator,
    ) -> Outlook | None:
        model, space = models.objective, study.search_space()
        best = self.ranking.first_by(models, study, trials)
        if model is None or best is None or not best.believed_feasible:
            return None
        search = AcquisitionSearch(
            provable(models, self.ahead), space, self.acquisition, rng, narrow=leaves_gaps(study)
        )
        cost = float(study.objective.to_cost(best.objective))
        search.incumbent = float(model.compression.apply(cost))
        maximum = search.maximize()
        if maximum.log_gain is None:
            return None
        x = space.to_cube(best.trial.parameters)[None]
        complete = EvaluationState.COMPLETE
        evaluations = sum(e.outcome.state is complete for e in best.trial.evaluations)
        noise = float(np.sqrt(model.variance_of_run(x)[0] / evaluations))
        return Outlook(cost, float(np.exp(maximum.log_gain)), noise)

    def answer_search(
        self, study: Study, trials: Sequence[Trial], most: int | None = None
    ) -> SettledAnswer:
        """Make the search for the answer: repetitions until it is settled."""
        if most is None:
            most = self.repetitions.most(study, count_evaluations(trials), count_checks(trials))
        own_runs = replace(self.own_runs, doubtful=1) if study.is_noiseless else self.own_runs
        if not self.models.simulation.trials:
            return SettledAnswer(study, trials, self.ranking, own_runs, most)
        # What the answer is shown to keep is by runs of the machine alone.
        alone = OwnRanking(self.models.alone)
        return SettledAnswer(study, trials, alone, own_runs, most, self.models)

    def doubt(self, feasibility: float) -> str:
        """Return why an answer is doubtful."""
        return f"By the model of all test runs it is {percent(feasibility)} likely within limits"

    def continued(
        self, trials: Sequence[Trial], evaluations: Sequence[Evaluation], *, more: bool
    ) -> list[Trial]:
        """Give trials the repetitions of a run that had ended: they are data for trials to come."""
        return with_known_repetitions(trials, evaluations, more=more)

    def checked(
        self, study: Study, trials: Sequence[Trial], evaluations: Iterable[Evaluation]
    ) -> list[Trial]:
        """Give trials their repetitions."""
        return with_all_repetitions(trials, evaluations)

    def estimated(self, study: Study, models: Surrogates, trial: Trial) -> Trial:
        """Estimate worst cases by the models of all evaluations."""
        return estimated(study, models, trial)

    def refusal(
        self, then: Study, now: Study, moved: Sequence[str], unsearched: Sequence[str]
    ) -> str:
        """Refuse nothing: an evaluation is data in whatever context."""
        return ""

    def knowing(self, study: Study, simulated: Sequence[Trial]) -> Self:
        """Return the method with a `Simulation` in its models."""
        if problem := self.simulation_problem(study):
            raise StudyError(problem)
        return replace(
            self, models=replace(self.models, simulation=Simulation.of(study, simulated))
        )

    def takes_parts(self) -> bool:
        """Return True: each evaluation is data by itself."""
        return True

    def hyperparameters(
        self, study: Study, trials: Sequence[Trial], rng: np.random.Generator
    ) -> Mapping[str, tuple[float, ...]]:
        """Return what its search takes from the models."""
        return self._search.hyperparameters(self.models, study, trials, rng)

    def most_evaluations(self, study: Study) -> int:
        """Return the largest number of evaluations of the trials and the repetitions."""
        searched = self.contexts.count(study)
        if study.worst_case_constraints:
            searched += search_evaluations(study, self.searched)
        by_trials = replace(study, budget=replace(study.budget, evaluations=None))
        ahead = self.schedule.evaluations_ahead(by_trials, 0, 0.0, searched)
        tuning = round(sum(ahead))
        if study.budget.evaluations is not None:
            largest = max(searched, sum(new_point(study)))
            tuning = min(tuning, study.budget.evaluations + largest - 1)
        return tuning + self.repetitions.most(study, tuning)

    def answer_evaluations(self, study: Study, evaluations: int, made: int) -> int:
        """Return the repetitions that are expected still."""
        return max(0, min(self.repetitions.most(study, evaluations), MOST_TO_SETTLE) - made)
