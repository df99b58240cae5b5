"""Ranking of the tried parameter sets; the first is the incumbent everywhere.

Parameter sets that are believed feasible are ranked by the posterior mean of the cost, worsened by
a penalty for a narrow optimum, the mean loss at the neighbours. The posterior mean limits the
influence of a single noisy evaluation; the penalty prefers a wide optimum to a narrow one with a
slightly lower cost. With several objectives, the cost is that of the compromise between them.

Neighbours are one step of an integer away. A real parameter has none: where a limit is active, a
step beyond it loses as much as its arbitrary length makes it, and the best parameter sets would
have the largest penalties. A gorge that is narrower than the length scales is smooth to the models.

Of a simulator without noise the models have nothing to add to what was run: a parameter set that
was beyond a limit in a context where it must hold is not feasible. With one context only, the
ranking is by the values of the runs, without models or penalties, and the first is the best run.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.fitting import FITTED_EACH
from bo_tuner.models.narrowness import intolerable, relative_excess, relative_loss
from bo_tuner.models.protocol import Model
from bo_tuner.models.scalarization import equal_weights
from bo_tuner.models.surrogates import FitSurrogates, S_co, Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.bayesian import latest_hyperparameters
from bo_tuner.study.parts import LOG
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState

LARGEST_PENALTY = 0.5
"""Largest penalty of a neighbour.

A narrow optimum loses to a wide one that costs no more than half as much again, by whatever factor
a limit is exceeded beside it. Where nothing was tried, that factor is the models' guess.
"""

BLOCK = 100
"""Number of parameter sets that the models are asked at a time, for speed with little memory."""

FEW = 10
"""Number of parameter sets that are asked for at a time where one of the first is looked for."""


@dataclass(frozen=True)
class Estimate:
    """Posterior of the mean of an objective's metric, in its unit.

    Attributes
    ----------
    mean
        Posterior mean.
    error
        A standard deviation; of a metric on the log scale to first order.
    """

    mean: float
    error: float


@dataclass(frozen=True)
class Candidate:
    """A tried parameter set and the surrogates' estimates for it.

    Attributes
    ----------
    trial
        The trial.
    objective
        Posterior mean of the first objective, in the metric's unit; where only the compromise
        between several is modelled, the mean of the first one over the trial's evaluations.
    feasibility
        Probability that all constraints hold.
    violation
        Largest predicted excess over a limit, relative to the limit; negative if all are kept.
    penalty
        Mean over the neighbours of the relative losses beyond `TOLERABLE`, in cost and in limits,
        `LARGEST_PENALTY` at most for each.
    score
        Posterior mean of the cost, worsened by the penalty; ranks the feasible candidates.
    required
        Lowest probability with which it counts as feasible.
    estimates
        Of several objectives, by metric, as far as each has a model of its own.
    """

    trial: Trial
    objective: float
    feasibility: float
    violation: float
    penalty: float
    score: float
    required: float = BELIEVED_FEASIBLE
    estimates: Mapping[str, Estimate] = field(default_factory=dict)

    @property
    def believed_feasible(self) -> bool:
        """Whether the probability of feasibility is high enough."""
        return self.feasibility >= self.required


@dataclass(frozen=True)
class Ranking(Generic[S_co]):
    """Ranks trials by surrogates.

    Attributes
    ----------
    fit
        Fits the surrogates.
    """

    fit: FitSurrogates[S_co]

    def sets(self, trials: Sequence[Trial]) -> Sequence[Trial]:
        """Return the trials that are ranked, of all trials."""
        return trials

    def required(self, trial: Trial) -> float:
        """Return the lowest probability with which a trial counts as feasible."""
        return BELIEVED_FEASIBLE

    def start(self, trials: Sequence[Trial]) -> Mapping[str, Sequence[float]]:
        """Return the hyperparameters that the fit of `models` starts from.

        Where the fits are costliest, those of many trials, it starts from those of the latest
        trial; elsewhere it starts anew.
        """
        return latest_hyperparameters(trials) if len(trials) > FITTED_EACH else {}

    def models(
        self,
        study: Study,
        trials: Sequence[Trial],
        start: Mapping[str, Sequence[float]] | None = None,
    ) -> S_co:
        """Fit the surrogates that the ranking asks.

        Parameters
        ----------
        study
            The study.
        trials
            All trials so far.
        start
            Hyperparameters for many trials that have recorded none (random search); by default
            those of a fit to `FITTED_EACH` trials, evenly chosen.
        """
        rng = generator(study.seed, Stream.ACQUISITION, 2**31, len(trials))
        count = len(study.objectives)
        weights = equal_weights(count) if count > 1 else None
        known = self.start(trials)
        if len(trials) > FITTED_EACH and not known:
            subset = trials[:: -(-len(trials) // FITTED_EACH)]
            known = start or self.fit(study, subset, rng=rng, weights=weights).warm_starts
        return self.fit(study, trials, rng=rng, start=known, weights=weights)

    def rank(self, study: Study, trials: Sequence[Trial]) -> list[Candidate]:
        """Rank the complete trials, except outliers of the objective.

        Trials believed feasible come first, by score; the others follow, the least violating first.

        Parameters
        ----------
        study
            The study.
        trials
            All trials so far.

        Returns
        -------
        list of Candidate
            Empty if no trial is complete.
        """
        return self.ranked_by(self.models(study, trials), study, trials)

    def incumbent(self, study: Study, trials: Sequence[Trial]) -> Candidate | None:
        """Return the first of `rank`, without the others; None if no trial is complete."""
        return self.first_by(self.models(study, trials), study, trials)

    def ranked_by(
        self, models: Surrogates, study: Study, trials: Sequence[Trial]
    ) -> list[Candidate]:
        """Rank trials, see `rank`, by surrogates that were fitted to them."""
        estimates = _Estimates(models, study, self.required)
        complete = self.comparable(models, study, trials)
        blocks = (complete[k : k + BLOCK] for k in range(0, len(complete), BLOCK))
        return sorted((c for block in blocks for c in estimates.candidates(block)), key=_place)

    def first_by(
        self, models: Surrogates, study: Study, trials: Sequence[Trial]
    ) -> Candidate | None:
        """Return the first of `ranked_by`, None without one; of many trials it asks about few."""
        estimates = _Estimates(models, study, self.required)
        complete = self.comparable(models, study, trials)
        if not complete:
            return None
        cost = estimates.cost(complete)
        order = np.argsort(cost, kind="stable")
        first: list[Candidate] = []
        for k in range(0, len(order), BLOCK):
            # No penalty is negative, so the score of those left is at least their cost.
            if first and first[0].believed_feasible and first[0].score < cost[order[k]]:
                break
            # In the order of the run, as `ranked_by` has a single block.
            block = estimates.candidates([complete[i] for i in sorted(order[k : k + BLOCK])])
            first = [min(first + block, key=_place)]
        return first[0]

    def lowest_cost(
        self, models: Surrogates, study: Study, trials: Sequence[Trial]
    ) -> float | None:
        """Return the lowest posterior mean of the cost of those believed feasible, None without.

        What is proposed is to improve on this. The score of the incumbent has a penalty, which a
        point that was not tried does not have.
        """
        estimates = _Estimates(models, study, self.required)
        complete = self.comparable(models, study, trials)
        if not complete:
            return None
        cost = estimates.cost(complete)
        order = np.argsort(cost, kind="stable")
        order = order[estimates.may_be_feasible([complete[i] for i in order])]
        for k in range(0, len(order), FEW):
            block = order[k : k + FEW]
            kept = estimates.believed_feasible([complete[i] for i in block])
            if kept.any():
                return float(cost[block[kept.argmax()]])
        return None

    def comparable(self, models: Surrogates, study: Study, trials: Sequence[Trial]) -> list[Trial]:
        """Return the complete trials, except outliers; `ranked_by` ranks these.

        Of runs that tell all, none is an outlier.
        """
        if models.objective is None:
            return []
        outliers = frozenset() if study.a_run_tells_all else models.outliers
        # The data of the objective's model exclude the outliers, so it cannot judge them.
        return [
            t
            for t in self.sets(trials)
            if t.state is TrialState.COMPLETE and t.number not in outliers
        ]


def _place(candidate: Candidate) -> tuple[int, float, int]:
    """Return what candidates are sorted by; of equal ones the earlier trial is first."""
    if candidate.believed_feasible:
        return 0, candidate.score, candidate.trial.number
    return 1, candidate.violation, candidate.trial.number


class _Estimates:
    """Asks surrogates about the trials that they were fitted to."""

    def __init__(
        self, models: Surrogates, study: Study, required: Callable[[Trial], float]
    ) -> None:
        self._models = models
        self._study = study
        self._space = study.search_space()
        self._required = required
        self._several = len(study.objectives) > 1
        self._by_values = study.a_run_tells_all
        limits = study.worst_case_constraints if study.is_noiseless else ()
        self._seen_limits = tuple(study.constraints.values()) if self._by_values else limits

    def cost(self, trials: Sequence[Trial]) -> Array:
        """Return the cost (n,) of trials: its posterior mean, or that of runs that tell all."""
        # The cost of a compromise is relative to the front, which the models have.
        if not self._by_values or self._several:
            return self._objective.predict_mean(self._points(trials))
        objective = self._study.objective
        values = [_complete(trial)[0].outcome.metrics[objective.metric] for trial in trials]
        return objective.to_cost(np.array(values))

    def feasibility(self, trials: Sequence[Trial]) -> Array:
        """Return the probability (n,) that trials keep all constraints."""
        kept = self._seen(trials) <= 0.0
        if self._by_values:
            return kept.astype(np.float64)
        return np.where(kept, self._models.feasibility(self._points(trials)), 0.0)

    def believed_feasible(self, trials: Sequence[Trial]) -> NDArray[np.bool_]:
        """Return which (n,) of the trials count as feasible."""
        return self.feasibility(trials) >= [self._required(trial) for trial in trials]

    def may_be_feasible(self, trials: Sequence[Trial]) -> NDArray[np.bool_]:
        """Return which (n,) of the trials are within their limits by their means.

        No others are believed feasible: where the mean exceeds a limit, that limit is kept with a
        probability below one half, and the mean costs less than the variance in every context.
        """
        return self._excess(trials) <= 0.0

    def _excess(self, trials: Sequence[Trial]) -> Array:
        """Return the largest excess (n,) of trials over a limit, relative to the limit's size."""
        seen = self._seen(trials)
        if self._by_values:
            return seen
        return np.maximum(seen, relative_excess(self._models, self._points(trials)))

    def _seen(self, trials: Sequence[Trial]) -> Array:
        """Return the same of runs without noise that refute a limit by themselves."""
        largest = [
            max(
                (
                    limit.excess(evaluation.outcome.metrics[limit.metric])
                    for limit in self._seen_limits
                    for evaluation in _complete(trial)
                ),
                default=-np.inf,
            )
            for trial in trials
        ]
        return np.array(largest)

    def candidates(self, trials: Sequence[Trial]) -> list[Candidate]:
        """Estimate trials; at most `BLOCK` of them, for speed with little memory."""
        study, x = self._study, self._points(trials)
        cost = self.cost(trials)
        penalties = self._penalties(trials, cost)
        score = self._penalized(cost, penalties)
        feasibility = self.feasibility(trials)
        excess = self._excess(trials)
        estimates = self._of_each(x)
        candidates = []
        for k, trial in enumerate(trials):
            if not self._several:
                objective = float(study.objective.from_cost(cost[k]))
            elif estimates[k]:
                objective = estimates[k][study.objective.metric].mean
            else:
                # The cost is that of the compromise, which has no unit.
                objective = float(np.mean(trial.observations(study.objective.metric)))
            candidates.append(
                Candidate(
                    trial=trial,
                    objective=objective,
                    feasibility=float(feasibility[k]),
                    violation=float(excess[k]),
                    penalty=float(penalties[k]),
                    score=float(score[k]),
                    required=self._required(trial),
                    estimates=estimates[k],
                )
            )
        return candidates

    def _of_each(self, x: Array) -> list[dict[str, Estimate]]:
        """Return the estimates of several objectives at x (m, d), as far as they are modelled."""
        by_point: list[dict[str, Estimate]] = [{} for _ in x]
        for objective in self._study.objectives if self._several else ():
            model = self._models.costs.get(objective.metric)
            if model is None:
                continue
            cost, variance = model.predict(x)
            value, deviation = objective.from_cost(cost), np.sqrt(variance)
            error = deviation * np.abs(value) if objective.scale == LOG else deviation
            for estimates, *of_point in zip(by_point, value.tolist(), error.tolist(), strict=True):
                estimates[objective.metric] = Estimate(*of_point)
        return by_point

    def _penalties(self, trials: Sequence[Trial], cost: Array) -> Array:
        """Return the penalties (n,) of trials with a `cost` (n,)."""
        if self._by_values:
            return np.zeros(len(trials))
        around = [self._space.integer_neighbour_points(trial.parameters) for trial in trials]
        owner = np.repeat(np.arange(len(trials)), [len(points) for points in around])
        if not len(owner):
            return np.zeros(len(trials))
        neighbours = np.vstack(around)
        neighbour_cost = self._objective.predict_mean(neighbours)
        loss = relative_loss(self._study, self._objective, neighbour_cost, cost[owner])
        lost = intolerable(loss) + intolerable(relative_excess(self._models, neighbours))
        lost = np.minimum(lost, LARGEST_PENALTY)
        count = np.bincount(owner, minlength=len(trials))
        return np.bincount(owner, lost, minlength=len(trials)) / np.maximum(count, 1)

    def _penalized(self, cost: Array, penalties: Array) -> Array:
        """Return the cost (n,) worsened by the `penalties` (n,)."""
        if self._several:
            penalized: Array = cost + self._objective.scale * penalties
            return penalized
        return self._study.objective.worsened(cost, penalties, self._objective.scale)

    @property
    def _objective(self) -> Model:
        if self._models.objective is None:
            raise ValueError("no trial is complete")
        return self._models.objective

    def _points(self, trials: Sequence[Trial]) -> Array:
        return self._space.cube_of(trial.parameters for trial in trials)


def _complete(trial: Trial) -> list[Evaluation]:
    return [evaluation for evaluation in trial.evaluations if evaluation.outcome.complete]
