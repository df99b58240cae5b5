"""How wide a violation must be for the evaluated contexts to have met it.

A search within a budget cannot find every violation. Let one fill a cube whose edge is the share w
of the context box's edges, with its middle anywhere in the box, every place being as likely; for a
discrete variable, at one of its values. The evaluated contexts meet it if one of them lies in the
cube, so if the largest coordinate difference from its middle to the nearest of them is w/2 at most.
The width that is met with a given probability is therefore twice a quantile of that distance.

This is geometry alone. A run within the violation makes its context a candidate, which is evaluated
again and again; where the noise is as large as the excess over the limit, it can be overlooked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated

import numpy as np
from scipy.spatial import KDTree

from bo_tuner.codec.rules import Null
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete
from bo_tuner.trials import Context

PROBABILITIES = (0.9, 0.5)
"""Probabilities of meeting a violation for which a width is given."""

PLACES = 20_000
"""Places of a violation that are tried, so that the standard error of a probability is 0.4 %."""

ELSEWHERE = 10.0
"""Distance, in edges of the box, of two values of a discrete variable: they never meet."""


@dataclass(frozen=True)
class SearchWidth:
    """A width of violations, and how probably the search meets one.

    Attributes
    ----------
    probability
        Of meeting it.
    width
        Smallest width that is met with this probability, as a share of the edges of the context
        box; above 1 if none is, infinite if discrete values were not evaluated.
    """

    probability: float
    width: Annotated[float, Null(inf)]


def search_widths(space: ContextSpace, contexts: Sequence[Context]) -> tuple[SearchWidth, ...]:
    """Return which widths of a violation evaluations in some contexts meet."""
    if all(isinstance(item, Discrete) for item in space.distributions):
        return ()
    distance = distances(space, contexts)
    return tuple(
        SearchWidth(p, 2.0 * float(np.quantile(distance, p, method="higher")))
        for p in PROBABILITIES
    )


def distances(space: ContextSpace, contexts: Sequence[Context]) -> Array:
    """Return the distance (n,) of n = `PLACES` random places to the nearest evaluated context.

    The largest difference of a coordinate, in edges of the box; infinite if no context has the
    discrete values of the place. The arguments are those of `search_widths`.
    """
    rng = np.random.default_rng(0)
    places = rng.random((PLACES, len(space.names)))
    apart = np.ones(len(space.names))
    for column, item in enumerate(space.distributions):
        if isinstance(item, Discrete):
            values = (item.support - item.lower) / (item.upper - item.lower)
            places[:, column] = rng.choice(values, PLACES)
            apart[column] = ELSEWHERE / np.diff(values).min()
    tree = KDTree(space.to_unit(space.rows(contexts)) * apart)
    distance, _ = tree.query(places * apart, p=np.inf)
    return np.where(distance > 1.0, np.inf, distance)
