"""What a certificate need not test in full: a limit that is kept by far.

How many runs a limit takes without any assumption is known (`sequential.draws_needed`). Most runs
are spent on what nobody doubts: a time that is a tenth of its limit, a context in which the machine
is far from it. Three rules save them. Each rests on more than the runs that are counted, as the
certificate says, and neither applies with ``certificate: {distribution_free: true}``.

- *A chance constraint* that every run keeps, the draws with such a margin that at twice their
  standard deviation any law keeps it as often as asked (Cantelli's inequality): the other runs of
  the parameter set count with the draws. They are in contexts that were chosen for their large
  values.
- *A context* that is not the worst one of a limit, and in which by a Gaussian process over the
  contexts a single run is `CLEAR` standard deviations within the limit: `FEW` runs must confirm it.
- *Another context behind the worst one*, by the same process: its runs must show the limit with the
  confidence `BEHIND`. A parameter set passes wrongly only if the process is wrong on which context
  is the worst, and then with a probability of 1 - `BEHIND` at most.
"""

from math import sqrt

from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.sequential import is_shown
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study

FEW = 5
"""Runs in a context that is clear."""

CLEAR = 3.0
"""Standard deviations of a single run from its mean to the limit, in a context that is clear."""

BEHIND = 0.8
"""Confidence with which a limit is shown in a context that by a model is not the worst."""

TWICE = 2.0
"""Factor of the draws' standard deviation."""

LEAST_DRAWS = 30
"""Draws behind a mean and a standard deviation, even if fewer decide the verdict."""


def least_draws(study: Study) -> int:
    """Return the least number of draws; without noise and contexts all would be the same."""
    return 1 if study.is_noiseless and not study.contexts else LEAST_DRAWS


def confirms(constraint: Constraint, values: Array) -> bool:
    """Return whether runs (n,) in a context that is clear by the process confirm it."""
    if len(values) < FEW or bool(constraint.violations(values).any()):
        return False
    return _margin(constraint, values) >= CLEAR * float(values.std(ddof=1))


def is_far_from(constraint: Constraint, draws: Array, others: Array) -> bool:
    """Return whether draws (n,), and other runs (m,), keep the limit of a chance constraint by far.

    Cantelli's inequality: at most 1 / (1 + k²) of the values of any law are beyond its mean by k
    standard deviations.
    """
    beyond = bool(constraint.violations([*draws, *others]).any())
    return len(draws) >= LEAST_DRAWS and not beyond and is_far(constraint, draws)


def is_far(constraint: Constraint, draws: Array) -> bool:
    """Return whether the limit is far from the mean of draws (n,), by their deviation."""
    deviations = TWICE * sqrt(1.0 / constraint.allowed - 1.0)
    return len(draws) > 1 and _margin(constraint, draws) >= deviations * float(draws.std(ddof=1))


def is_shown_by_all(constraint: Constraint, draws: Array, others: Array, confidence: float) -> bool:
    """Return whether a chance constraint that is kept by far is shown by all runs together."""
    count = len(draws) + len(others)
    return is_far_from(constraint, draws, others) and is_shown(
        [False] * count, constraint.allowed, confidence
    )


def said_of_draws(constraint: Constraint, draws: Array, others: Array) -> str:
    """Say on what it rests that all runs together show a chance constraint."""
    deviation = float(draws.std(ddof=1))
    far = ""
    if deviation > 0.0:
        times = _margin(constraint, draws) / deviation
        # Runs that differ by rounding alone have a deviation, too.
        far = f", by {f'{times:.3g}' if times < 1e3 else 'over 1000'} of their standard deviations"
    return (
        f"{len(others)} runs in other contexts count with the {len(draws)} draws, as all of them "
        f"keep the limit by far{far}"
    )


def _margin(constraint: Constraint, values: Array) -> float:
    return constraint.sign * (constraint.limit - float(values.mean()))
