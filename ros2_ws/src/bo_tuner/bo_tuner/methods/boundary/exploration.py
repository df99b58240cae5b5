"""When a trial looks elsewhere than where improvement is expected, and where.

Where no limit binds, the search ends at the bottom of the basin that it knows: what further trials
can gain there is below what their noise lets anyone tell, and a model whose length scales were
learnt in a wide basin is sure that there is no other. Its own uncertainty cannot say where to look,
so such a trial goes to the point that is farthest from all tried ones, of those that are expected
to keep the limits and not to fail. It is every other trial, so that whatever is found is followed
up, and none at the end of the budget, which refines.

Where a limit binds, trials at its boundary are not lost, however small the gain: they show which
side of it a parameter set is on. That is told by the costs: beyond a limit that binds they are
lower than within all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.bayesian import SPACE_FILLING_CANDIDATES, AcquisitionSearch, farthest
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class Exploration:
    """Which trials may look elsewhere.

    Attributes
    ----------
    every
        Each so many-th trial may.
    until
        Part of the budget after which none may; 0 for none at all.
    """

    every: int = 2
    until: float = 0.8

    def is_due(self, study: Study, trials: int, evaluations: int) -> bool:
        """Return whether the trial after so many, with so many evaluations, may look elsewhere."""
        spent = study.budget.part_spent(trials, evaluations)
        return trials % self.every == 0 and spent < self.until


def ends_in_a_basin(
    surrogates: PooledSurrogates,
    space: SearchSpace,
    acquisition: AcquisitionRule,
    avoid: float,
    rng: np.random.Generator,
) -> bool:
    """Return whether no limit binds, and the expected gain is below what can be told from noise.

    Parameters
    ----------
    surrogates
        Models of all trials.
    space, acquisition
        Of the search.
    avoid
        Largest probability of a failure of a proposal.
    rng
        Of the search for the largest gain.
    """
    model = surrogates.objective
    if model is None:
        return False
    lowest = int(model.predict_mean(model.points).argmin())
    if surrogates.log_feasibility(model.points[[lowest]])[0] < np.log(BELIEVED_FEASIBLE):
        return False
    gain = AcquisitionSearch(surrogates, space, acquisition, rng).maximize(avoid=avoid).value
    error = np.sqrt(model.noise_variance / model.counts[lowest])
    return bool(np.exp(gain) < error)


def elsewhere(
    surrogates: PooledSurrogates,
    space: SearchSpace,
    trials: Sequence[Trial],
    avoid: float,
    rng: np.random.Generator,
) -> Array | None:
    """Return the point (d,), among random ones, that is farthest from all trials.

    None if all of them are expected to fail or to violate a limit. Arguments as in
    `ends_in_a_basin`.
    """
    candidates = space.latin_hypercube(SPACE_FILLING_CANDIDATES, rng)
    kept = surrogates.log_feasibility(candidates) >= np.log(BELIEVED_FEASIBLE)
    for classifier in surrogates.classifiers:
        kept &= classifier.probability(candidates) <= avoid
    if not kept.any():
        return None
    return farthest(space, space.cube_of(t.parameters for t in trials), candidates[kept])
