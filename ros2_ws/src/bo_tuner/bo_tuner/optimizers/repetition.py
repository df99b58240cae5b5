"""Which parameter set to run again, and in which context, before the answer is given.

A posterior that chooses among many parameter sets is too optimistic of the one that it chooses: the
errors of the data and of the fit are part of the choice. So the answer must have runs of its own
where its limits are most doubtful, made after it was chosen or while it was searched. What is worth
further runs is a parameter set that is better than the answer but not shown to be feasible: the one
with the largest expected gain, improvement times probability of feasibility.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.joint_responses import EveryContext
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.special import log_expected_improvement
from bo_tuner.optimizers.ranking import Candidate, looks
from bo_tuner.study.study import Study
from bo_tuner.trials import CHECKS, EvaluationState, Trial

OWN_RUNS = 4
"""Runs of its own that the answer must have where each limit is most doubtful."""

NEAR = 0.15
"""Distance in every coordinate of the unit cube up to which contexts count as the same."""

WORTH_REPEATING = 0.02
"""Least probability of feasibility of a parameter set that is run again."""

NEGLIGIBLE = 1e-3
"""Largest expected gain, in standard deviations of the cost, that is not worth a run."""


@dataclass(frozen=True)
class Repetition:
    """Runs of a known parameter set.

    Attributes
    ----------
    trial
        Its trial.
    context
        Context of the runs; None for contexts drawn from the distribution.
    """

    trial: Trial
    context: Mapping[str, float] | None

    @property
    def runs(self) -> int:
        """Number of runs until the parameter set is judged anew, see `looks`."""
        repetitions = sum(e.stage in CHECKS for e in self.trial.evaluations)
        return int(2 ** (looks(self.trial) + 1)) - repetitions


def next_repetition(
    study: Study, surrogates: Surrogates, candidates: Sequence[Candidate]
) -> Repetition | None:
    """Return the runs that tell most of what the answer is; None if that is settled.

    Parameters
    ----------
    study
        The study.
    surrogates
        Models of all trials.
    candidates
        All candidates as they rank them.
    """
    best = candidates[0] if candidates and candidates[0].believed_feasible else None
    if best is not None:
        lacking = [
            place
            for place in _doubtful(study, surrogates, best.trial)
            if place.context is not None and _own_runs(study, place) < OWN_RUNS
        ]
        if lacking:
            return lacking[0]
    chosen = _challenger(study, surrogates, candidates, best)
    if chosen is None:
        return None
    return _doubtful(study, surrogates, chosen.trial)[0]


def _challenger(
    study: Study, surrogates: Surrogates, candidates: Sequence[Candidate], best: Candidate | None
) -> Candidate | None:
    open_ones = [c for c in candidates if WORTH_REPEATING < c.feasibility < c.required]
    if not open_ones or surrogates.objective is None:
        return None
    space = study.search_space()
    x = np.array([space.to_cube(c.trial.parameters) for c in open_ones])
    value = np.log([c.feasibility for c in open_ones])
    if best is not None:
        _, variance = surrogates.objective.predict(x)
        score = np.array([c.score for c in open_ones])
        value += log_expected_improvement(score, variance, best.score)
    chosen = int(np.argmax(value))
    if best is not None and value[chosen] < np.log(NEGLIGIBLE * surrogates.objective.scale):
        return None
    return open_ones[chosen] if np.isfinite(value[chosen]) else None


def _doubtful(study: Study, surrogates: Surrogates, trial: Trial) -> list[Repetition]:
    """Return where each limit of a parameter set is most doubtful, the least probable one first."""
    space, contexts = study.search_space(), study.context_space()
    x = space.to_cube(trial.parameters)[None]
    found: list[tuple[float, Repetition]] = []
    for constraint in surrogates.limits:
        context = None
        if isinstance(constraint, EveryContext):
            row, log_probability = constraint.most_doubtful(x)
            context = contexts.to_dict(contexts.to_contexts(constraint.contexts[row])[0])
        else:
            log_probability = constraint.log_probability(x)
        found.append((float(log_probability[0]), Repetition(trial, context)))
    return [item for _, item in sorted(found, key=lambda pair: pair[0])]


def _own_runs(study: Study, place: Repetition) -> int:
    """Return the number of complete runs of a parameter set near a context."""
    contexts = study.context_space()
    done = [
        e.context for e in place.trial.evaluations if e.outcome.state is EvaluationState.COMPLETE
    ]
    if not done or place.context is None:
        return 0
    apart: Array = np.abs(contexts.cube_of(done) - contexts.cube_of([place.context]))
    return int((apart <= NEAR).all(axis=1).sum())
