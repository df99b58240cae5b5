"""Functions of the context that explain why one draw differs from the next.

They are the polynomials of the context variables up to a total degree, with indicators of texts and
truth values, each without its expectation over the distribution of the context, which is known. The
degree follows from the numbers of draws and of variables alone: chosen by what is seen in the
draws, the interval of an adjusted mean would not be what it says.
"""

from collections.abc import Sequence

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.trials import Context

DRAWS_EACH = 5
"""Draws for each covariate, at least: one that explains nothing widens the interval."""

FEWEST = 20
"""Draws from which on the interval of an adjusted mean holds as often as it says
(benchmarks/band_coverage.py --means-only)."""

HIGHEST = 3
"""Largest total degree."""

QUANTILES = 4096
"""Of each variable, whose mean is taken for an expectation."""

Term = tuple[int, Array]
"""A function of the context with an expectation of 0: its degree, and its values (n,)."""


def covariates(space: ContextSpace, contexts: Sequence[Context]) -> Array:
    """Return covariates (n, p) of n contexts, each with an expectation of 0.

    They have the largest total degree at which there are `DRAWS_EACH` draws for each; there are
    none where the draws are too few already for the first degree, or fewer than `FEWEST`.
    """
    n = len(contexts)
    most = n // DRAWS_EACH if n >= FEWEST else 0
    rows = space.rows(contexts)
    middles = (np.arange(QUANTILES) + 0.5) / QUANTILES
    law = space.at_quantiles(np.tile(middles[:, None], (1, len(space.names))))
    for degree in range(HIGHEST, 0, -1):
        # Products of terms of different variables, which are independent, have none either.
        terms: list[Term] = [(0, np.ones(n))]
        for column, item in enumerate(space.distributions):
            own = _terms(item, rows[:, column], law[:, column], degree)
            terms += [(d + e, f * g) for d, f in terms for e, g in own if d + e <= degree]
            if len(terms) > most + 1:
                break
        else:
            return np.column_stack([f for _, f in terms])[:, 1:]
    return np.empty((n, 0))


def _terms(item: Distribution, values: Array, law: Array, degree: int) -> list[Term]:
    """Return terms of one variable up to a degree, by quantiles (m,) of its law."""
    if item.labels:
        levels = range(1, len(item.labels))
        return [(1, (values == level) - float(np.mean(law == level))) for level in levels]
    if isinstance(item, Discrete):
        # More powers than that are combinations of these.
        degree = min(degree, len(item.values) - 1)
    mean, deviation = float(law.mean()), float(law.std())
    here, everywhere = (values - mean) / deviation, (law - mean) / deviation
    return [(d, here**d - float(np.mean(everywhere**d))) for d in range(1, degree + 1)]
