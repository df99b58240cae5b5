"""Ranking of the tried parameter sets; the first is the incumbent everywhere.

Parameter sets that are believed feasible are ranked by the posterior mean of the cost, worsened by
a penalty for a narrow optimum, the mean loss at the neighbours. The posterior mean limits the
influence of a single noisy evaluation; the penalty prefers a wide optimum to a narrow one with a
slightly lower cost. With several objectives, the cost is that of the compromise between them.

Neighbours are one step of an integer away. A real parameter has none: where a limit is active, a
step beyond it loses as much as its arbitrary length makes it, and the best parameter sets would
have the largest penalties. A gorge that is narrower than the length scales is smooth to the models.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bo_tuner.models.constraints import BELIEVED_FEASIBLE, CONFIDENT
from bo_tuner.models.fitting import DEFAULT_MODELS, FITTED_EACH, ModelOptions
from bo_tuner.models.protocol import Model
from bo_tuner.models.scalarization import equal_weights
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.bayesian import latest_hyperparameters
from bo_tuner.study.study import Study
from bo_tuner.trials import CHECKS, Trial, TrialState, pooled

TOLERABLE = 0.2
"""Largest relative loss at a neighbour that is not penalized.

Where a limit is active, some neighbours always exceed it slightly.
"""

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
class Candidate:
    """A tried parameter set and the surrogates' estimates for it.

    Attributes
    ----------
    trial
        The trial.
    objective
        Posterior mean of the objective, in the metric's unit; of several the mean of the first one
        over the trial's evaluations.
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
    """

    trial: Trial
    objective: float
    feasibility: float
    violation: float
    penalty: float
    score: float
    required: float = BELIEVED_FEASIBLE

    @property
    def believed_feasible(self) -> bool:
        """Whether the probability of feasibility is high enough."""
        return self.feasibility >= self.required


def rank(
    study: Study,
    trials: Sequence[Trial],
    options: ModelOptions = DEFAULT_MODELS,
) -> list[Candidate]:
    """Rank the complete trials, except outliers of the objective.

    Trials believed feasible come first, by score; the others follow, the least violating first.

    Parameters
    ----------
    study
        The study.
    trials
        All trials so far.
    options
        As in `Surrogates.fit`.

    Returns
    -------
    list of Candidate
        Empty if no trial is complete.
    """
    return ranked_by(ranking_models(study, trials, options), study, trials, options)


def incumbent(
    study: Study, trials: Sequence[Trial], options: ModelOptions = DEFAULT_MODELS
) -> Candidate | None:
    """Return the first of `rank`, without the others; None if no trial is complete."""
    return first_by(ranking_models(study, trials, options), study, trials, options)


def ranking_models(
    study: Study,
    trials: Sequence[Trial],
    options: ModelOptions = DEFAULT_MODELS,
    start: Mapping[str, Sequence[float]] | None = None,
) -> Surrogates:
    """Fit the surrogates that `rank` asks; its arguments.

    Those of pooled evaluations or of many trials start from the hyperparameters of the latest
    trial, as these are the costliest fits. If there are none, as in random search, those of many
    trials start from `start`, by default from a fit to `FITTED_EACH` trials, evenly chosen.
    """
    rng = generator(study.seed, Stream.ACQUISITION, 2**31, len(trials))
    many = len(trials) > FITTED_EACH
    count = len(study.objectives)
    weights = equal_weights(count) if count > 1 else None
    known: Mapping[str, Sequence[float]] = {}
    if options.pooled or many:
        known = latest_hyperparameters(trials)
    if many and not known:
        some = trials[:: -(-len(trials) // FITTED_EACH)]
        known = (
            start
            or Surrogates.fit(study, some, rng=rng, options=options, weights=weights).warm_starts
        )
    return Surrogates.fit(study, trials, rng=rng, start=known, options=options, weights=weights)


def ranked_by(
    models: Surrogates, study: Study, trials: Sequence[Trial], options: ModelOptions
) -> list[Candidate]:
    """Rank trials by surrogates that were fitted to them; otherwise as `rank`."""
    ranking = _Ranking(models, study, options)
    complete = comparable(models, trials, options)
    blocks = (complete[k : k + BLOCK] for k in range(0, len(complete), BLOCK))
    return sorted((c for block in blocks for c in ranking.candidates(block)), key=_place)


def first_by(
    models: Surrogates, study: Study, trials: Sequence[Trial], options: ModelOptions
) -> Candidate | None:
    """Return the first of `ranked_by`, None without one; of many trials it asks about few."""
    ranking = _Ranking(models, study, options)
    complete = comparable(models, trials, options)
    if not complete:
        return None
    cost = ranking.cost(complete)
    order = np.argsort(cost, kind="stable")
    first: list[Candidate] = []
    for k in range(0, len(order), BLOCK):
        # No penalty is negative, so the score of those left is at least their cost.
        if first and first[0].believed_feasible and first[0].score < cost[order[k]]:
            break
        # In the order of the run, as `ranked_by` has a single block.
        found = ranking.candidates([complete[i] for i in sorted(order[k : k + BLOCK])])
        first = [min(first + found, key=_place)]
    return first[0]


def lowest_cost(
    models: Surrogates, study: Study, trials: Sequence[Trial], options: ModelOptions
) -> float | None:
    """Return the lowest posterior mean of the cost of those believed feasible, None without one.

    What is proposed is to improve on this. The score of the incumbent has a penalty, which a point
    that was not tried does not have.
    """
    ranking = _Ranking(models, study, options)
    complete = comparable(models, trials, options)
    if not complete:
        return None
    cost = ranking.cost(complete)
    order = np.argsort(cost, kind="stable")
    order = order[ranking.may_be_feasible([complete[i] for i in order])]
    for k in range(0, len(order), FEW):
        block = order[k : k + FEW]
        kept = ranking.believed_feasible([complete[i] for i in block])
        if kept.any():
            return float(cost[block[kept.argmax()]])
    return None


def comparable(
    models: Surrogates, trials: Sequence[Trial], options: ModelOptions = DEFAULT_MODELS
) -> list[Trial]:
    """Return the complete trials, except outliers; `ranked_by` ranks these."""
    if models.objective is None:
        return []
    # The data of the objective's model exclude the outliers, so it cannot judge them.
    return [
        t
        for t in (pooled(trials) if options.pooled else trials)
        if t.state is TrialState.COMPLETE and t.number not in models.outliers
    ]


def _place(candidate: Candidate) -> tuple[int, float, int]:
    """Return what candidates are sorted by; of equal ones the earlier trial is first."""
    if candidate.believed_feasible:
        return 0, candidate.score, candidate.trial.number
    return 1, candidate.violation, candidate.trial.number


class _Ranking:
    """Asks surrogates about the trials that they were fitted to."""

    def __init__(self, models: Surrogates, study: Study, options: ModelOptions) -> None:
        self._models = models
        self._study = study
        self._space = study.search_space()
        self._pooled = options.pooled
        self._several = len(study.objectives) > 1

    def cost(self, trials: Sequence[Trial]) -> Array:
        """Return the posterior mean (n,) of the cost of trials."""
        return self._objective.predict_mean(self._points(trials))

    def feasibility(self, trials: Sequence[Trial]) -> Array:
        """Return the probability (n,) that trials keep all constraints."""
        return self._models.feasibility(self._points(trials))

    def required(self, trial: Trial) -> float:
        """Return the lowest probability with which a trial counts as feasible."""
        return required_of(trial) if self._pooled else BELIEVED_FEASIBLE

    def believed_feasible(self, trials: Sequence[Trial]) -> NDArray[np.bool_]:
        """Return which (n,) of the trials count as feasible."""
        return self.feasibility(trials) >= [self.required(trial) for trial in trials]

    def may_be_feasible(self, trials: Sequence[Trial]) -> NDArray[np.bool_]:
        """Return which (n,) of the trials are within their limits by their means.

        No others are believed feasible: where the mean exceeds a limit, that limit is kept with a
        probability below one half, and the mean costs less than the variance in every context.
        """
        return relative_excess(self._models, self._points(trials)) <= 0.0

    def candidates(self, trials: Sequence[Trial]) -> list[Candidate]:
        """Estimate trials; at most `BLOCK` of them, for speed with little memory."""
        models, study = self._models, self._study
        x = self._points(trials)
        cost = self._objective.predict_mean(x)
        penalties = self._penalties(trials, cost)
        score = self._penalized(cost, penalties)
        feasibility = self.feasibility(trials)
        excess = relative_excess(models, x)
        found = []
        for k, trial in enumerate(trials):
            objective = float(study.objective.from_cost(cost[k]))
            if self._several:
                # The cost is that of the compromise, which has no unit.
                objective = float(np.mean(trial.observations(study.objective.metric)))
            found.append(
                Candidate(
                    trial=trial,
                    objective=objective,
                    feasibility=float(feasibility[k]),
                    violation=float(excess[k]),
                    penalty=float(penalties[k]),
                    score=float(score[k]),
                    required=self.required(trial),
                )
            )
        return found

    def _penalties(self, trials: Sequence[Trial], cost: Array) -> Array:
        """Return the penalties (n,) of trials with a `cost` (n,)."""
        around = [self._space.integer_neighbour_points(trial.parameters) for trial in trials]
        owner = np.repeat(np.arange(len(trials)), [len(points) for points in around])
        if not len(owner):
            return np.zeros(len(trials))
        neighbours = np.vstack(around)
        there = self._objective.predict_mean(neighbours)
        loss = relative_loss(self._study, self._objective, there, cost[owner])
        lost = intolerable(loss) + intolerable(relative_excess(self._models, neighbours))
        lost = np.minimum(lost, LARGEST_PENALTY)
        count = np.bincount(owner, minlength=len(trials))
        return np.bincount(owner, lost, minlength=len(trials)) / np.maximum(count, 1)

    def _penalized(self, cost: Array, penalties: Array) -> Array:
        """Return the cost (n,) that loses as much as the `penalties` (n,) say."""
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


def looks(trial: Trial) -> int:
    """Return how often a parameter set was judged anew after it had been run again.

    It is judged whenever the number of its repetitions has doubled, to 2, 4, 8 and so on: whoever
    looks after each run and stops when it looks well finds a limit kept that is not.
    """
    return max(_repetitions(trial).bit_length() - 1, 0)


def runs_until(trial: Trial, judged: int) -> int:
    """Return after how many further runs a trial has been judged so often, see `looks`."""
    return int(2**judged) - _repetitions(trial)


def _repetitions(trial: Trial) -> int:
    return sum(evaluation.stage in CHECKS for evaluation in trial.evaluations)


def required_of(trial: Trial) -> float:
    """Return the probability with which a parameter set counts as feasible if runs are pooled.

    What is lacking to 1 is divided by the number of judgements, each as if it were the last: with
    1, 2, 3 of them the shares are 1, 1/2, 1/3, whose sum is not bounded.
    """
    return required_after(looks(trial))


def required_after(judged: int) -> float:
    """Return `required_of` a parameter set that was judged so often."""
    return 1.0 - (1.0 - CONFIDENT) / (1 + judged)


def intolerable(loss: Array) -> Array:
    """Return the part (m,) of relative losses (m,) that exceeds `TOLERABLE`."""
    return np.maximum(loss - TOLERABLE, 0.0)


def relative_loss(study: Study, objective: Model, cost: Array, reference: Array) -> Array:
    """Return the `Objective.relative_loss` (m,) that a model of the cost predicts.

    Of several objectives, that of the cost of the compromise, relative to its spread.

    Parameters
    ----------
    study
        The study.
    objective
        The model.
    cost, reference : ndarray, shape (m,)
        Means that it predicts, and those that they are compared with.
    """
    if len(study.objectives) > 1:
        return (cost - reference) / objective.scale
    return study.objective.relative_loss(cost, reference, objective.scale)


def relative_excess(models: Surrogates, x: Array) -> Array:
    """Return the largest predicted excess (m,) over a limit at x (m, d).

    Relative to the limit's size, as `Constraint.excess`; not relative to a limit of 0.
    """
    if not models.constraints:
        return np.full(len(x), -np.inf)
    excess = [c.excess(x) / (abs(c.limit) or 1.0) for c in models.constraints.values()]
    largest: Array = np.max(excess, axis=0)
    return largest
