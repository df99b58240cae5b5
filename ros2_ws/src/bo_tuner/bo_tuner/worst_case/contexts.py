"""Shared parts of the worst-case searches: priors and swarm."""

from math import sqrt

from bo_tuner.models.hyperpriors import Hyperpriors, LogNormal

DECIDED = 2.0
"""Standard deviations between the constrained quantity and the limit that end a search."""

# A few evaluations cannot distinguish noise from a short length scale. The priors state what is
# expected of a plant in a bounded box: a smooth response, on which the context has more influence
# than noise.
PRIORS = Hyperpriors(
    length_scale=LogNormal(0.7, 0.5, 0.1, 20.0),
    signal=LogNormal(1.0, 0.5, 0.05, 20.0),
    noise=LogNormal(0.15, 0.5, 1e-3, 3.0),
)


def is_clear(distance: float, variance: float, asked: int) -> bool:
    """Return whether a limit is kept or violated for sure, at a distance above the mean."""
    error = DECIDED * sqrt(variance)
    # A model with few data can be overconfident: the limit counts as kept only after an evaluation
    # at the maximum of the upper confidence bound.
    return distance < -error or (distance > error and asked > 0)
