"""Stage one of `boundary`: search, then settle which side of the limits the best points are on.

Where limits are active, the optimum lies on the boundary of the feasible region, and what decides
is not finding it but knowing on which side of it a parameter set is. Each trial is a new parameter
set. Those of the first part of the budget are a search, with few evaluations each; until a
parameter set is believed feasible, it is one for the way to the limits (`approach`). Those of the
second part are proposed against the best parameter set that is *shown* to keep all limits, with a
probability of at least `CONFIDENT`, and where it is probable that a few more runs show the same of
them: of a point that only just keeps a limit, no budget shows that it does. They have two runs in
their worst context and one in a drawn one, or three in drawn ones where all limits are over the
contexts. Before the answer, parameter sets are run again where it is most doubtful that they keep
their limits; `repetition` decides which, and when that is settled.

All evaluations are pooled in the processes over parameter set and context
(`bo_tuner.models.pooled_process`). The answer is the parameter set with the lowest predicted cost
among those that are shown to keep all limits.

References
----------
Gibbs and Candès (2021). Adaptive conformal inference under distribution shift. NeurIPS 34.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule
from bo_tuner.methods.boundary.approach import Approach
from bo_tuner.methods.boundary.exploration import Exploration, elsewhere, ends_in_a_basin
from bo_tuner.methods.boundary.hopeless import hopeless_beyond
from bo_tuner.methods.boundary.judging import PooledRanking
from bo_tuner.models.constraints import CONFIDENT
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.models.pooled_responses import FutureBound
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.base import ACQUISITION, SPACE_FILLING, Hopeless, Proposal
from bo_tuner.optimizers.bayesian import (
    AcquisitionSearch,
    BayesianOptimization,
    PointRule,
    leaves_gaps,
    lowest_believed,
)
from bo_tuner.optimizers.box import Box
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState, Value, count_evaluations, count_trials

DOOMED = 0.95
"""Probability of a failure from which on no point is proposed as long as there are others."""

DRAWN, WORST = 1, 2
"""Evaluations of a new point: in drawn contexts, and where limits are most doubtful."""


Avoidance = Callable[[Study, Sequence[Trial]], float]
"""Returns the largest probability of a failure of a proposal, by all trials so far."""


@dataclass(frozen=True)
class AdaptedAvoidance:
    """Largest probability of a failure of a proposal, adapted to how often one failed.

    A model of crashes is too sure of itself where proposals go, to the edge of the region where
    runs fail, and far from all trials. So each failure lowers the largest probability, which is
    `failing` at first, and each success raises it, by steps that keep the share of failures at
    `failing` (adaptive conformal inference, Gibbs and Candès, 2021, on the logarithm).

    Attributes
    ----------
    failing
        Share of the proposals that may fail, since a crash can cost a machine more than a run is
        worth.
    adaptation
        Halvings of the largest probability by each failure. A run has some tens of trials, in which
        the bound must be able to find its level: ten in a row that do not fail open almost every
        region, and a single failure closes the doubtful ones again.
    """

    failing: float = 0.1
    adaptation: float = 3.0

    def __call__(self, study: Study, trials: Sequence[Trial]) -> float:
        """Return the largest probability of a failure of the next proposal."""
        level, highest = 0.0, np.log2(DOOMED / self.failing)
        for trial in trials[study.budget.initial_trials :]:
            if trial.unusable or trial.state is TrialState.CUT_SHORT:
                continue
            failed = trial.state is TrialState.FAILED
            level += self.adaptation * (-1.0 if failed else self.failing / (1.0 - self.failing))
            level = min(level, highest)
        return float(self.failing * 2.0**level)


@dataclass(frozen=True)
class Schedule:
    """Which trials are a search, and which at the boundary.

    Attributes
    ----------
    searching
        Part of the budget for the search.
    """

    searching: float = 0.5

    def searches(self, study: Study, trials: int, evaluations: int) -> bool:
        """Return whether the next trial, after these numbers, is one of the search."""
        return study.budget.part_spent(trials, evaluations) < self.searching

    def evaluations_ahead(
        self, study: Study, trials: int, evaluations: float, searched: float
    ) -> Iterator[float]:
        """Yield the evaluations of each trial to come: `searched` in one of the search."""
        while study.budget.remaining(trials, round(evaluations)):
            searching = self.searches(study, trials, round(evaluations))
            count = searched if searching else sum(new_point(study))
            yield count
            trials, evaluations = trials + 1, evaluations + count


class BoundaryOptimization(BayesianOptimization[PooledSurrogates]):
    """Optimizer of `boundary`.

    Parameters
    ----------
    study
        The study.
    ranking
        Of the parameter sets, and with it the models.
    acquisition
        Makes the acquisition function.
    schedule
        Says which trials are a search.
    ahead
        Further runs of a new point after which it should be shown to keep its limits.
    avoidance
        Largest probability of a failure.
    exploration
        Which trials may look elsewhere than where improvement is expected.
    approach
        Where a first feasible parameter set is searched.
    """

    def __init__(
        self,
        study: Study,
        ranking: PooledRanking,
        acquisition: AcquisitionRule,
        schedule: Schedule,
        ahead: int,
        avoidance: Avoidance,
        exploration: Exploration,
        approach: Approach,
    ) -> None:
        super().__init__(study, ranking.fit, acquisition)
        self._ranking = ranking
        self._schedule = schedule
        self._ahead = ahead
        self._avoidance = avoidance
        self._exploration = exploration
        self._approach = approach

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal:
        """Propose the next trial and its evaluations."""
        planned = sum(len(trial.evaluations) for trial in pending)
        done = count_trials(self.trials) + len(pending), count_evaluations(self.trials) + planned
        self.pending = tuple(pending)
        points: PointRule[PooledSurrogates] = self._most_promising
        protocol = None
        if not self._schedule.searches(self.study, *done):
            points, protocol = self._at_boundary, new_point(self.study)
        if self._exploration.is_due(self.study, *done):
            points = self._elsewhere_before(points)
        initial = self.initial()
        return self.propose(points, protocol) if initial is None else self._bounded(initial)

    @property
    def avoid(self) -> float:
        """Largest probability of a failure of a proposal, as long as others exist."""
        return self._avoidance(self.study, self.trials)

    def around(self, surrogates: PooledSurrogates) -> Box | None:
        """Return the box around the least violating parameter set, see `Approach`."""
        known = self._ranking.comparable(surrogates, self.study, self.trials)
        return self._approach.box(surrogates, self.study, known)

    def hopeless(self, surrogates: PooledSurrogates, parameters: Mapping[str, Value]) -> Hopeless:
        """Return beyond what a run of a parameter set is hopeless, if runs may be cut short.

        As long as no parameter set is believed to keep all limits no run is: by how much each
        violates them is what leads to where they are kept.
        """
        if not self.study.budget.cut_short:
            return Hopeless()
        lowest = self._ranking.lowest_cost(surrogates, self.study, self.trials)
        if lowest is None:
            return Hopeless()
        return hopeless_beyond(self.study, surrogates, self.space.to_cube(parameters), lowest)

    def _bounded(self, initial: Proposal) -> Proposal:
        """Return a proposal of the initial design with what is hopeless, if enough is known."""
        complete = sum(trial.state is TrialState.COMPLETE for trial in self.trials)
        if not self.study.budget.cut_short or not self.suffice(complete):
            return initial
        try:
            surrogates = self._models(self.study, self.trials, rng=self.rng())
            return replace(initial, hopeless=self.hopeless(surrogates, initial.parameters))
        except (ArithmeticError, np.linalg.LinAlgError, ValueError):
            return initial

    def _elsewhere_before(self, points: PointRule[PooledSurrogates]) -> PointRule[PooledSurrogates]:
        """Return a rule that first explores if the search ends in a basin, before `points`."""

        def rule(
            surrogates: PooledSurrogates, rng: np.random.Generator
        ) -> Iterator[tuple[Array, str]]:
            # A generator of its own, so that the search draws the same with and without this check.
            (own,) = rng.spawn(1)
            if ends_in_a_basin(surrogates, self.space, self._rule, self.avoid, own):
                tried = [*self.trials, *self.pending]
                point = elsewhere(surrogates, self.space, tried, self.avoid, own)
                if point is not None:
                    yield point, SPACE_FILLING
            yield from points(surrogates, rng)

        return rule

    def _at_boundary(
        self, surrogates: PooledSurrogates, rng: np.random.Generator
    ) -> Iterator[tuple[Array, str]]:
        """Yield the most promising points that a few runs are likely to show feasible."""
        models = provable(surrogates, self._ahead)
        search = AcquisitionSearch(
            models, self.space, self._acquisition, rng, narrow=leaves_gaps(self.study)
        )
        model = models.objective
        lowest = self._ranking.lowest_cost(surrogates, self.study, self.trials)
        search.incumbent = None
        if lowest is not None and model is not None:
            search.incumbent = float(model.compression.apply(lowest))
        within = self.within(surrogates, found=lowest_believed(surrogates) is not None)
        for avoid in (self.avoid, 1.0):
            result = search.maximize(avoid=avoid, within=within)
            if np.isfinite(result.value):
                yield result.position, ACQUISITION


def provable(surrogates: PooledSurrogates, ahead: int) -> Surrogates:
    """Return surrogates that predict whether `ahead` runs would show each limit kept."""
    constraints = {
        name: FutureBound(response, ahead, CONFIDENT)
        for name, response in surrogates.constraints.items()
    }
    return Surrogates(
        surrogates.objective,
        constraints,
        surrogates.failures,
        surrogates.outlying,
        surrogates.outliers,
        surrogates.models,
    )


def new_point(study: Study) -> tuple[int, int]:
    """Return the evaluations of a point at the boundary: in drawn and in worst contexts.

    A limit over the contexts is doubtful in drawn ones, so where all are, the runs are made there.
    """
    worst = WORST * len(study.worst_case_constraints)
    if worst or not study.constraints or study.a_run_tells_all:
        return DRAWN, worst
    return DRAWN + WORST, 0
