"""Parameter sets that are better than the answer of a run by the models, but were not chosen.

Either it is not shown that they keep their limits, or no runs were left for those of its own that
an answer needs.
"""

from collections.abc import Sequence

from bo_tuner.methods.boundary.repetition import NEGLIGIBLE
from bo_tuner.methods.recommendation import PassedOver
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.optimizers.ranking import Candidate


def passed_over(
    models: Surrogates, answer: Candidate, candidates: Sequence[Candidate]
) -> tuple[PassedOver, ...]:
    """Return the parameter sets that were passed over for an answer, the best one first.

    They more probably keep all limits than not, and their gain is worth a run.

    Parameters
    ----------
    models
        Of all evaluations.
    answer
        The candidate that was chosen.
    candidates
        All candidates.
    """
    least = NEGLIGIBLE * models.objective.scale if models.objective is not None else 0.0
    better = [
        candidate
        for candidate in candidates
        if candidate.score < answer.score - least and candidate.feasibility >= BELIEVED_FEASIBLE
    ]
    return tuple(
        PassedOver(c.trial.number, c.objective, c.feasibility, c.believed_feasible)
        for c in sorted(better, key=lambda c: c.score)
    )
