"""The algorithm `boundary`: search, then settle which side of the limits the best points are on.

Where limits are active, the optimum lies on the boundary of the feasible region, and what decides
is not finding it but knowing on which side of it a parameter set is. Each trial is a new parameter
set. Those of the first part of the budget are a search, with few evaluations each. Those of the
second part are proposed against the best parameter set that is *shown* to keep all limits, with a
probability of at least `CONFIDENT`, and where it is probable that a few more runs show the same of
them: of a point that only just keeps a limit, no budget shows that it does. They have two runs in
their worst context and one in a drawn one. Before the answer, parameter sets are run again where it
is most doubtful that they keep their limits; `bo_tuner.optimizers.repetition` decides which, and
when that is settled.

All evaluations are pooled in the processes over parameter set and context
(`bo_tuner.models.pooled_process`). The answer is the parameter set with the lowest predicted cost
among those that are shown to keep all limits.

References
----------
Gibbs and Candès (2021). Adaptive conformal inference under distribution shift. NeurIPS 34.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bo_tuner.models.constraints import CONFIDENT
from bo_tuner.models.pooled_responses import FutureBound, PooledResponse
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.base import ACQUISITION, Proposal
from bo_tuner.optimizers.bayesian import AcquisitionSearch, BayesianOptimization
from bo_tuner.optimizers.ranking import lowest_cost
from bo_tuner.study.study import Study
from bo_tuner.trials import TrialState, count_evaluations, count_trials

SEARCHING = 0.5
"""Part of the budget for the search."""

FAILING = 0.1
"""Share of the proposals that may fail, since a crash can cost a machine more than a run tells."""

DOOMED = 0.95
"""Probability of a failure from which on no point is proposed as long as there are others."""

ADAPTATION = 3.0
"""Halvings of the largest probability of a failure by each failure.

A run has some tens of trials, in which the bound must be able to find its level: ten in a row that
do not fail open almost every region, and a single failure closes the doubtful ones again.
"""

AHEAD = 8
"""Further runs of a new point after which it should be shown to keep its limits."""

DRAWN, WORST = 1, 2
"""Evaluations of a new point: in drawn contexts, and in the worst one of each constraint."""


class BoundaryOptimization(BayesianOptimization):
    """Optimizer of the algorithm `boundary`.

    Parameters
    ----------
    study, options, acquisition
        As `BayesianOptimization`.
    """

    def ask(self) -> Proposal:
        """Propose the next trial and its evaluations."""
        if searches(self.study, count_trials(self.trials), count_evaluations(self.trials)):
            return super().ask()
        return self.initial() or self.propose(self._at_boundary, new_point(self.study))

    @property
    def avoid(self) -> float:
        """Largest probability of a failure of a proposal, adapted to how often one failed.

        A model of crashes is too sure of itself where proposals go, to the edge of the region where
        runs fail, and far from all trials. So each failure lowers the largest probability, which is
        `FAILING` at first, and each that ends without one raises it, as much as keeps the share of
        failures there (as in the adaptive conformal inference of Gibbs and Candès, 2021, on the
        logarithm).
        """
        level, highest = 0.0, np.log2(DOOMED / FAILING)
        for trial in self.trials[self.study.budget.initial_trials :]:
            if trial.spoilt:
                continue
            failed = trial.state is TrialState.FAILED
            level += ADAPTATION * (-1.0 if failed else FAILING / (1.0 - FAILING))
            level = min(level, highest)
        return float(FAILING * 2.0**level)

    def _at_boundary(
        self, surrogates: Surrogates, rng: np.random.Generator
    ) -> Iterator[tuple[Array, str]]:
        """Yield the most promising points that a few runs are likely to show feasible."""
        search = AcquisitionSearch(provable(surrogates), self.space, self._acquisition, rng)
        search.incumbent = lowest_cost(surrogates, self.study, self.trials, self._options)
        for avoid in (self.avoid, 1.0):
            result = search.maximize(avoid=avoid)
            if np.isfinite(result.value):
                yield result.position, ACQUISITION


def provable(surrogates: Surrogates) -> Surrogates:
    """Return surrogates with the probability that `AHEAD` runs show a limit kept for its own."""
    constraints = {
        name: FutureBound(response, AHEAD, CONFIDENT)
        for name, response in surrogates.constraints.items()
        if isinstance(response, PooledResponse)
    }
    return replace(surrogates, constraints=constraints)


def searches(study: Study, trials: int, evaluations: int) -> bool:
    """Return whether a trial is one of the search, after so many with so many evaluations."""
    parts = [trials / study.budget.trials]
    if study.budget.evaluations is not None:
        parts.append(evaluations / study.budget.evaluations)
    return max(parts) < SEARCHING


def new_point(study: Study) -> tuple[int, int]:
    """Return the evaluations of a point at the boundary: in drawn and in worst contexts."""
    return DRAWN, WORST * len(study.worst_case_constraints)


def evaluations_ahead(
    study: Study, trials: int, evaluations: float, searched: float
) -> Iterator[float]:
    """Yield the evaluations of each trial to come; a trial of the search has `searched` of them."""
    while study.budget.remaining(trials, round(evaluations)):
        searching = searches(study, trials, round(evaluations))
        count = searched if searching else sum(new_point(study))
        yield count
        trials, evaluations = trials + 1, evaluations + count
