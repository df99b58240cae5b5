"""What the models of a run without a feasible parameter set expect elsewhere.

The largest probability with which a parameter set within the bounds keeps all limits is searched by
a space-filling sample and steps from its best points, so it is a lower bound of the maximum. Beyond
a bound the models extrapolate; it counts only where they believe in feasible sets there, and in
none within.
"""

from dataclasses import dataclass

import numpy as np

from bo_tuner.models.constraints import BELIEVED_FEASIBLE
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.ranking import BLOCK
from bo_tuner.study.limit_kinds.limited import LOWER, UPPER
from bo_tuner.study.study import Study

SAMPLED = 512
"""Parameter sets that the models are asked about first."""
BEST, STEPS, LENGTH = 16, 16, 0.05
"""How many of these steps begin at, how many at each, and their standard deviation in the cube."""
BEYOND = 0.25
"""How far beyond a bound the models are asked, as a share of the range on its scale."""


@dataclass(frozen=True)
class Beyond:
    """What the models expect beyond a bound of a parameter.

    Attributes
    ----------
    parameter, side
        Its name, and ``lower`` or ``upper``.
    chance
        Largest probability there that all limits are kept.
    """

    parameter: str
    side: str
    chance: float


@dataclass(frozen=True)
class Prospects:
    """What the models expect where nothing was found feasible.

    Attributes
    ----------
    chance
        Largest probability with which a parameter set within the bounds keeps all limits.
    beyond
        The bounds beyond which feasible ones are to be expected, the likeliest first.
    """

    chance: float
    beyond: tuple[Beyond, ...] = ()


def prospects_in(study: Study, models: Surrogates) -> Prospects:
    """Return what models that were fitted to all trials expect elsewhere."""
    space, rng = study.search_space(), generator(study.seed, Stream.PROSPECTS)
    points = space.latin_hypercube(SAMPLED, rng)
    best = points[np.argsort(-_feasibility(models, points), kind="stable")[:BEST]]
    steps = np.repeat(best, STEPS, axis=0)
    steps = space.repair(np.clip(steps + LENGTH * rng.standard_normal(steps.shape), 0.0, 1.0))
    points = np.vstack([best, steps])
    chances = _feasibility(models, points)
    chance = float(chances.max())
    if chance >= BELIEVED_FEASIBLE:
        return Prospects(chance)
    beyond = []
    for name in space.numbers:
        own = points[space.has(name, points)]
        for side, coordinate in ((LOWER, -BEYOND), (UPPER, 1.0 + BEYOND)):
            if not len(own):
                continue
            moved = own.copy()
            moved[:, space.names.index(name)] = coordinate
            beyond.append(Beyond(name, side, float(_feasibility(models, moved).max())))
    expected = [item for item in beyond if item.chance >= BELIEVED_FEASIBLE]
    return Prospects(chance, tuple(sorted(expected, key=lambda item: -item.chance)))


def _feasibility(models: Surrogates, points: Array) -> Array:
    blocks = (points[k : k + BLOCK] for k in range(0, len(points), BLOCK))
    return np.concatenate([models.feasibility(block) for block in blocks])
