"""Which parameter set to run again, and in which context, before the answer is given.

A posterior that chooses among many parameter sets is too optimistic of the one that it chooses: the
errors of the data and of the fit are part of the choice. So the answer must have runs of its own
where its limits are most doubtful, made after it was chosen or while it was searched. Where the
worst context differs from that of all earlier parameter sets, the posterior knows nothing of it:
the answer must also have been run in the corners of the contexts, if they are few. Further runs go
to a parameter set that is better than the answer but not shown to be feasible, the one with the
largest expected gain for each of the runs that are likely to show it. The gain alone would prefer
one that lies so close to a limit that all runs are too few for it (Frazier and Powell 2010).

Challengers come before the own runs of the answer, which would be lost on one that is then
replaced. As many runs as the answer lacks are kept in reserve, and no challenger is run that could
not get its own any more: it would be shown to be better, and be passed over all the same.

References
----------
Frazier and Powell (2010). Paradoxes in learning and the marginal value of information. Decision
Analysis 7(4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.methods.boundary.judging import judgements, required_after, runs_until
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.models.pooled_responses import PooledResponse, bound_after
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Stage, Trial

NEAR = 0.15
"""Distance in every coordinate of the unit cube up to which contexts count as the same."""

WORTH_REPEATING = 0.02
"""Least probability of feasibility of a parameter set that is run again."""

NEGLIGIBLE = 1e-3
"""Largest expected gain, in standard deviations of the cost, that is not worth a run."""


@dataclass(frozen=True)
class OwnRuns:
    """The runs of its own that a parameter set must have to be the answer.

    Attributes
    ----------
    doubtful
        Runs where each limit is most doubtful. Far from a limit that context moves with each run;
        then as many repetitions in all such contexts together are enough.
    corners
        Largest number of corners of the contexts in all of which it must have been run. With more
        of them, the runs that they take are better spent where a limit is doubtful.
    """

    doubtful: int = 4
    corners: int = 8


@dataclass(frozen=True)
class Repetition:
    """Runs of a known parameter set.

    Attributes
    ----------
    trial
        Its trial.
    context
        Context of the runs; None for contexts drawn from the distribution.
    runs
        How many, before the parameter set is judged anew.
    """

    trial: Trial
    context: Context | None
    runs: int


def next_repetition(
    study: Study,
    surrogates: PooledSurrogates,
    candidates: Sequence[Candidate],
    left: int,
    required: OwnRuns,
) -> Repetition | None:
    """Return the runs that do most to settle the answer; None if it is settled.

    Parameters
    ----------
    study
        The study.
    surrogates
        Models of all trials.
    candidates
        All candidates as they rank them.
    left
        Number of runs that are left.
    required
        Runs of its own that the answer must have.
    """
    best = candidates[0] if candidates and candidates[0].believed_feasible else None
    own = lacking(study, surrogates, best.trial, required) if best is not None else []
    challenger = _challenger(study, surrogates, candidates, best, left - len(own))
    if challenger is not None:
        doubtful = _doubtful(study, surrogates, challenger.trial)[0]
        runs = runs_until(challenger.trial, judgements(challenger.trial) + 1)
        if study.is_noiseless and doubtful is not None:
            # More of them would be the same.
            runs = 1
        # These runs are some of its own.
        its_own = len(lacking(study, surrogates, challenger.trial, required))
        if best is None or max(runs + len(own), its_own) <= left:
            return Repetition(challenger.trial, doubtful, runs)
    return Repetition(best.trial, own[0], 1) if best is not None and own else None


def lacking(
    study: Study, surrogates: PooledSurrogates, trial: Trial, required: OwnRuns
) -> list[Context]:
    """Return the contexts of the runs of its own that a parameter set lacks to be the answer.

    They are made one at a time, since the first of them may show that another one is the answer,
    and each may move the most doubtful context; so the number is an estimate. `required` says how
    many runs of its own the answer must have.
    """
    doubtful = _doubtful(study, surrogates, trial)
    contexts = [context for context in doubtful if context is not None]
    corners = _Corners(study, trial)
    made = sum(e.stage is Stage.CHECK_WORST for e in trial.evaluations)
    most = required.doubtful * len(contexts) + int(corners.seen.sum())
    missing = (required.doubtful - _own_runs(study, trial, context) for context in contexts)
    missing_contexts = [c for c, count in zip(contexts, missing, strict=True) for _ in range(count)]
    return missing_contexts[: max(0, most - made)] + corners.unseen(surrogates, required.corners)


def _challenger(
    study: Study,
    surrogates: PooledSurrogates,
    candidates: Sequence[Candidate],
    best: Candidate | None,
    left: int,
) -> Candidate | None:
    open_ones = [
        c
        for c in candidates
        if WORTH_REPEATING < c.feasibility < c.required
        and not (study.is_noiseless and _is_told(study, surrogates, c.trial))
    ]
    if not open_ones or surrogates.objective is None:
        return None
    space = study.search_space()
    x = space.cube_of(c.trial.parameters for c in open_ones)
    gain = np.zeros(len(open_ones))
    if best is not None:
        _, variance = surrogates.objective.predict(x)
        score = np.array([c.score for c in open_ones])
        gain = log_expected_improvement(score, variance, best.score)
    forecasts = [(limit, np.array(limit.forecast(x))) for limit in surrogates.limits]
    plans = [
        _plan(candidate, [(limit, known[:, k]) for limit, known in forecasts], left)
        for k, candidate in enumerate(open_ones)
    ]
    runs, log_shown = np.array(plans).T
    chosen = int(np.argmax(gain + log_shown - np.log(runs)))
    value = gain[chosen] + log_shown[chosen]
    if best is not None and value < np.log(NEGLIGIBLE * surrogates.objective.scale):
        return None
    return open_ones[chosen] if np.isfinite(value) else None


def _plan(
    candidate: Candidate, forecasts: Sequence[tuple[PooledResponse, Array]], left: int
) -> tuple[int, float]:
    """Return how many runs show best for their number that a candidate is feasible.

    Parameters
    ----------
    candidate
        The candidate.
    forecasts
        Each limit, with its `forecast` (3,) of the candidate.
    left
        Number of runs that are left.

    Returns
    -------
    int
        Number of runs until one of the next times that it is judged, see `judgements`.
    float
        Log probability that it is shown to be feasible then.
    """
    plans: list[tuple[int, float]] = []
    judged = judgements(candidate.trial) + 1
    while not plans or runs_until(candidate.trial, judged) <= left:
        runs, required = runs_until(candidate.trial, judged), required_after(judged)
        shown = [
            limit.log_kept(*bound_after(limit, known[:, None], runs, required))[0]
            for limit, known in forecasts
        ]
        plans.append((runs, float(sum(shown))))
        judged += 1
    return max(plans, key=lambda plan: plan[1] - np.log(plan[0]))


def _doubtful(study: Study, surrogates: PooledSurrogates, trial: Trial) -> list[Context | None]:
    """Return where each limit of a parameter set is most doubtful, the least probable one first.

    That is None for a limit on runs in drawn contexts.
    """
    space, contexts = study.search_space(), study.context_space()
    x = space.to_cube(trial.parameters)[None]
    doubtful: list[tuple[float, Context | None]] = []
    for limit in surrogates.limits:
        point, log_probability = limit.doubtful_context(x)
        context = None
        if point is not None:
            context = contexts.to_dict(contexts.to_contexts(point[None])[0])
        doubtful.append((log_probability, context))
    return [context for _, context in sorted(doubtful, key=lambda pair: pair[0])]


def _is_told(study: Study, surrogates: PooledSurrogates, trial: Trial) -> bool:
    """Return whether a parameter set was run where its limits are most doubtful."""
    doubtful = _doubtful(study, surrogates, trial)
    return bool(doubtful) and doubtful[0] is not None and _own_runs(study, trial, doubtful[0]) > 0


class _Corners:
    """Corners of the contexts, and in which of them a parameter set was run."""

    def __init__(self, study: Study, trial: Trial) -> None:
        contexts = study.context_space()
        corners = contexts.to_contexts(contexts.corners())
        self._cube = contexts.to_cube(corners)
        self._contexts = [contexts.to_dict(corner) for corner in corners]
        self._point = study.search_space().to_cube(trial.parameters)
        self.seen = np.array([_own_runs(study, trial, c) > 0 for c in self._contexts])

    def unseen(self, surrogates: PooledSurrogates, most: int) -> list[Context]:
        """Return those in which it was not run yet, the most doubtful one first.

        None of them if there are more than `most`, or if no limit is one in every context.
        """
        if self.seen.all() or len(self.seen) > most:
            return []
        log_probabilities = [
            limit.log_kept_in(self._point[None], self._cube) for limit in surrogates.limits
        ]
        kept = [log_kept for log_kept in log_probabilities if log_kept is not None]
        if not kept:
            return []
        order = np.argsort(np.sum(kept, axis=0), kind="stable")
        return [self._contexts[k] for k in order if not self.seen[k]]


def _own_runs(study: Study, trial: Trial, context: Context) -> int:
    """Return the number of complete runs of a parameter set near a context."""
    contexts = study.context_space()
    done = [e.context for e in trial.evaluations if e.outcome.complete]
    if not done:
        return 0
    apart: Array = np.abs(contexts.cube_of(done) - contexts.cube_of([context]))
    return int((apart <= NEAR).all(axis=1).sum())
