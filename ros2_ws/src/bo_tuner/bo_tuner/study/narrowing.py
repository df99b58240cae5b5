"""A study with narrower distributions of its contexts, from samples of where a machine is."""

from collections.abc import Mapping
from dataclasses import replace
from math import ceil, floor

import numpy as np

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.distributions import Discrete, Distribution, TruncatedNormal
from bo_tuner.study.parts import INTEGER, ContextVariable
from bo_tuner.study.study import Study

LEAST_WIDTH = 1e-3
"""Width of the new bounds, of that of the old ones, at least: a context needs room to vary."""


def narrowed(study: Study, contexts: Array, probability: float) -> Study:
    """Return a study whose contexts have the distribution of samples.

    A number is normal within bounds; of a discrete variable the probable values are left. All
    bounds together hold at least the given share of the samples.

    Parameters
    ----------
    study
        With the box in which the samples lie.
    contexts : ndarray, shape (m, v)
        Samples of its contexts, equally weighted, in their own units.
    probability
        Share of the samples within all bounds, between 0 and 1.
    """
    share = 1.0 - (1.0 - probability) / len(study.contexts)
    variables = {
        name: replace(variable, distribution=_narrowed(variable, column, share))
        for (name, variable), column in zip(study.contexts.items(), contexts.T, strict=True)
    }
    return replace(study, contexts=variables)


def _narrowed(variable: ContextVariable, values: Array, share: float) -> Distribution:
    """Return the distribution of samples (m,) of a variable, with this share within its bounds."""
    earlier = variable.distribution
    if isinstance(earlier, Discrete):
        return _fewer(earlier, values, share)
    rest = 0.5 * (1.0 - share)
    low, high = map(float, np.quantile(values, [rest, 1.0 - rest]))
    least = LEAST_WIDTH * (earlier.upper - earlier.lower)
    is_integer = variable.type == INTEGER
    if is_integer:
        low, high, least = float(floor(low)), float(ceil(high)), 1.0
    if high - low < least:
        low = low if is_integer else 0.5 * (low + high - least)
        high = low + least
        inward = max(earlier.lower - low, 0.0) - max(high - earlier.upper, 0.0)
        low, high = low + inward, high + inward
    mean = float(np.clip(values.mean(), low, high))
    deviation = max(float(values.std()), 0.25 * least)
    return TruncatedNormal(mean=mean, standard_deviation=deviation, bounds=(low, high))


def _fewer(earlier: Discrete, values: Array, share: float) -> Discrete:
    """Return the most probable values of a discrete variable, at least two of them."""
    numbers = np.array([earlier.number(value) for value in earlier.values])
    frequency = (values[:, None] == numbers).mean(axis=0)
    order = np.argsort(-frequency, kind="stable")
    count = max(2, 1 + int(np.searchsorted(np.cumsum(frequency[order]), share - 1e-12)))
    kept = sorted(order[:count])
    # A value that no sample has is kept possible.
    weights = np.maximum(frequency[kept], 1.0 / len(values))
    weights = weights / weights.sum()
    return Discrete(
        values=tuple(earlier.values[k] for k in kept),
        probabilities=tuple(map(float, weights)),
    )


def beyond(study: Study, box: Study, contexts: Array) -> Mapping[str, float]:
    """Return by variable the share of samples outside of the bounds of a study; none if it is 0.

    Parameters
    ----------
    study
        The study.
    box
        With contexts among which may be those of the study, in which the samples lie.
    contexts : ndarray, shape (m, v)
        Samples of the contexts of the box, in their own units.
    """
    shares: dict[str, float] = {}
    for name, values in zip(box.contexts, contexts.T, strict=True):
        if name in study.contexts and not study.contexts[name].distribution.labels:
            bounds = study.contexts[name].distribution
            share = float(((values < bounds.lower) | (values > bounds.upper)).mean())
            shares |= {name: share} if share else {}
    return shares
