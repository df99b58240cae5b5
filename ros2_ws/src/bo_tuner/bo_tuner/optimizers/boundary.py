"""The algorithm `boundary`: search, then settle which side of the limits the best points are on.

Where limits are active, the optimum lies on the boundary of the feasible region, and what decides
is not finding it but knowing on which side of it a parameter set is. The first part of the budget
is a search with few evaluations a trial. Then two kinds of trial alternate:

- a *repetition*: one run of a known parameter set in its most doubtful context. It is the one with
  the largest expected gain, improvement times probability of feasibility, among those that are
  better than the answer but not yet shown to be feasible.
- a *new point* by the same criterion, with two runs in its worst context and one in a drawn one.

All evaluations are pooled in the processes over parameter set and context
(`bo_tuner.models.joint_process`). The answer is the parameter set with the lowest predicted cost
among those that keep all limits with a probability of at least `CONFIDENT`.
"""

from collections.abc import Sequence

import numpy as np

from bo_tuner.acquisition.acquisition import Acquisition, AcquisitionRule
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.optimizers.base import ACQUISITION, SPACE_FILLING, Proposal
from bo_tuner.optimizers.bayesian import (
    AcquisitionSearch,
    BayesianOptimization,
    latest_hyperparameters,
    space_filling,
)
from bo_tuner.optimizers.ranking import Candidate, ranked_by
from bo_tuner.study.study import Study
from bo_tuner.trials import Stage, Trial, count_evaluations

REPETITION = "repetition"

SEARCHING = 0.5
"""Part of the budget for the search."""

SETTLING = 0.85
"""Part of the budget after which new points must be feasible with a probability of `SETTLED`."""

SETTLED = 0.99
"""As runs of a new point move its probability, it is to be beyond that of the answer."""

DRAWN, WORST = 1, 2
"""Evaluations of a new point: in drawn contexts, and in the worst one of each constraint."""

LACKING = 1e3
"""Weight of the logarithm of what a probability lacks."""

OWN_RUNS = 3
"""Runs of its own that the answer must have where it is most doubtful."""

WORTH_REPEATING = 0.02
"""Least probability of feasibility of a parameter set that is evaluated again."""


class BoundaryOptimization(BayesianOptimization):
    """Optimizer of the algorithm `boundary`.

    Parameters
    ----------
    study, options, acquisition
        As `BayesianOptimization`.
    """

    # A crash costs a machine more than an evaluation that tells less: the edge of the region where
    # runs fail is approached from the safe side.
    avoid = 0.2

    def ask(self) -> Proposal:
        """Propose the next trial and its evaluations."""
        proposal = self.initial()
        if proposal is not None:
            return proposal
        if spent(self.study, self.trials) < SEARCHING:
            return super().ask()
        return self._at_boundary()

    def _at_boundary(self) -> Proposal:
        rng = self.rng()
        warm = latest_hyperparameters(self.trials)
        warnings: tuple[str, ...] = ()
        try:
            surrogates = Surrogates.fit(
                self.study, self.trials, rng=rng, start=warm, options=self._options
            )
            warnings = surrogates.warnings
            warm |= surrogates.warm_starts
            candidates = ranked_by(surrogates, self.study, self.trials, self._options)
            again = self._repetition(candidates, surrogates)
            if again is not None:
                parameters = dict(again.trial.parameters)
                return Proposal(parameters, REPETITION, warnings, warm, self._one_run)
            rule = self._acquisition
            if spent(self.study, self.trials) >= SETTLING:
                rule = _shown(rule)
            search = AcquisitionSearch(surrogates, self.space, rule, rng)
            answer = _answer(candidates)
            if answer is not None:
                search.incumbent = float(self.study.objective.to_cost(answer.objective))
            else:
                search.incumbent = None
            for avoid in (self.avoid, 1.0):
                result = search.maximise(avoid=avoid)
                if np.isfinite(result.value):
                    parameters = self.space.to_parameters(result.position)
                    if self._key(parameters) not in {self._key(t.parameters) for t in self.trials}:
                        return Proposal(parameters, ACQUISITION, warnings, warm, self._new_point)
        except (ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
            warnings += (f"no acquisition: {type(error).__name__}: {error}",)
        cube = space_filling(self.space, self._tried(), rng)
        parameters = self.space.to_parameters(cube)
        return Proposal(parameters, SPACE_FILLING, warnings, warm, self._new_point)

    @property
    def _new_point(self) -> tuple[int, int]:
        return DRAWN, WORST * len(self.study.worst_case_constraints)

    @property
    def _one_run(self) -> tuple[int, int]:
        return (0, 1) if self.study.worst_case_constraints else (1, 0)

    def _repetition(
        self, candidates: Sequence[Candidate], surrogates: Surrogates
    ) -> Candidate | None:
        """Return the candidate to evaluate again; None for a new point."""
        answer = _answer(candidates)
        if answer is not None and self._own_runs(answer.trial) < OWN_RUNS:
            return answer
        open_ones = [c for c in candidates if WORTH_REPEATING < c.feasibility < c.required]
        if not open_ones or self.trials[-1].origin == REPETITION or surrogates.objective is None:
            return None
        x = np.array([self.space.to_cube(c.trial.parameters) for c in open_ones])
        crashes, *_ = surrogates.classifiers
        value = np.log([c.feasibility for c in open_ones]) + crashes.log_complement(x)
        if answer is not None:
            _, variance = surrogates.objective.predict(x)
            score = np.array([c.score for c in open_ones])
            value += log_expected_improvement(score, variance, answer.score)
        best = int(np.argmax(value))
        return open_ones[best] if np.isfinite(value[best]) else None

    def _own_runs(self, trial: Trial) -> int:
        """Return the number of runs of a pooled trial where its limit was most doubtful."""
        if not self.study.worst_case_constraints:
            return OWN_RUNS
        if self.study.context_space().dimension == 0:
            return len(trial.evaluations)
        return sum(evaluation.stage is Stage.SEARCH for evaluation in trial.evaluations)


def _answer(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the best candidate that is shown to be feasible, if there is one."""
    return candidates[0] if candidates and candidates[0].believed_feasible else None


def _shown(rule: AcquisitionRule) -> AcquisitionRule:
    """Return a rule that first of all asks for a probability of feasibility of `SETTLED`."""

    def make(
        surrogates: Surrogates,
        incumbent: float | None,
        *,
        avoid: float = 0.5,
        reinterpolate: bool = True,
    ) -> Acquisition:
        acquisition = rule(surrogates, incumbent, avoid=avoid, reinterpolate=reinterpolate)

        def shown(x: Array) -> Array:
            lacking = np.minimum(surrogates.log_feasibility(x) - np.log(SETTLED), 0.0)
            total: Array = acquisition(x) + LACKING * lacking
            return total

        return shown

    return make


def spent(study: Study, trials: Sequence[Trial]) -> float:
    """Return the part of the budget that trials have used."""
    parts = [len(trials) / study.budget.trials]
    if study.budget.evaluations is not None:
        parts.append(count_evaluations(trials) / study.budget.evaluations)
    return max(parts)
