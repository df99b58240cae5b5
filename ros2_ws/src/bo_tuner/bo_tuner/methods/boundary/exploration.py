"""When and where a trial explores, instead of following the expected improvement.

Where no limit binds, the search ends at the bottom of the basin that it knows: what further trials
can gain there is lost in their noise, and a model that has learnt its length scales in a wide basin
is sure that there is no other. Its own uncertainty cannot say where to look, so such a trial goes
to the middle of the largest gap between all tried ones, among places that are expected to keep the
limits and not to fail. If it finds another basin, the expected gain there is large, and the next
trials follow it up. The end of the budget refines what was found.

Where a limit binds, trials at its boundary are not lost, however small the gain: they show which
side of it a parameter set is on. Whether one binds is seen in the costs: beyond it they are lower
than within all limits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.acquisition.acquisition import AcquisitionRule
from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.bayesian import SPACE_FILLING_CANDIDATES, AcquisitionSearch, distances
from bo_tuner.study.search_space import SearchSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class Exploration:
    """Which trials may look elsewhere.

    Attributes
    ----------
    until
        Part of the budget after which no trial explores; with 0 none does.
    """

    until: float = 0.8

    def is_due(self, study: Study, trials: int, evaluations: int) -> bool:
        """Return whether the next trial, after those of these numbers, may explore."""
        return study.budget.part_spent(trials, evaluations) < self.until


def ends_in_a_basin(
    surrogates: PooledSurrogates,
    space: SearchSpace,
    acquisition: AcquisitionRule,
    avoid: float,
    rng: np.random.Generator,
) -> bool:
    """Return whether no limit binds, and the expected gain is lost in the noise.

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
    """Return the middle (d,) of the largest gap between all trials, among random points.

    It is the point with the largest distance to the trials, and to the faces of the cube. Else
    nearly all of them would be at the faces: a place there is half empty. Distances to trials grow
    with √d, and those to faces count as many times as much.

    None if all of them are expected to fail or to violate a limit, by the models of all trials;
    `avoid` is the largest probability of a failure.
    """
    candidates = space.latin_hypercube(SPACE_FILLING_CANDIDATES, rng)
    kept = surrogates.log_feasibility(candidates) >= np.log(BELIEVED_FEASIBLE)
    for classifier in surrogates.classifiers:
        kept &= classifier.probability(candidates) <= avoid
    if not kept.any():
        return None
    candidates = candidates[kept]
    apart = distances(space, space.cube_of(t.parameters for t in trials), candidates)
    numbers = candidates[:, np.array(space.levels) == 0]
    if numbers.shape[1]:
        to_face = np.minimum(numbers, 1.0 - numbers).min(axis=1)
        apart = np.minimum(apart, 2.0 * np.sqrt(numbers.shape[1]) * to_face)
    middle: Array = candidates[int(apart.argmax())]
    return middle
