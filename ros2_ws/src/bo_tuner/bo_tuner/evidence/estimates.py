"""What is known of the mean of a metric for one parameter set: one estimate, with its kind.

Screens and files take it from here. Estimates differ by the runs that they are of, which stand as
one word beside the number: fresh draws of a validation or of a certificate, the runs of a trial
itself, or all runs by way of the models. Those of fresh draws are adjusted for the contexts that
were drawn, where there are enough.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.codec.rules import Null
from bo_tuner.evidence.context_covariates import covariates
from bo_tuner.evidence.differences import CONFIDENCE
from bo_tuner.numerics.adjusted_means import adjusted_mean
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.trials import Context


class Source(StrEnum):
    """Of which runs an estimate is."""

    MODEL = "model"
    TUNING = "tuning"
    VALIDATION = "validation"
    CERTIFICATE = "certificate"


@dataclass(frozen=True)
class Estimate:
    """The mean of a metric for a parameter set, in the metric's unit.

    Attributes
    ----------
    value, error
        The estimate and its standard error; NaN if not known.
    count
        Number of complete runs.
    source
        Of which runs it is.
    adjusted
        Whether it is adjusted for the contexts that were drawn.
    low, high
        Ends of its interval with `CONFIDENCE`; infinite where the runs are too few.
    """

    value: float
    error: float
    count: int
    source: Source
    adjusted: bool
    low: Annotated[float, Null(-inf)]
    high: Annotated[float, Null(inf)]

    @property
    def kind(self) -> str:
        """Of which runs it is, and whether it is adjusted, in a few words."""
        return f"{self.source}, adjusted for contexts" if self.adjusted else str(self.source)


def of_runs(values: ArrayLike, source: Source, of_contexts: Array | None = None) -> Estimate:
    """Return the estimate by independent values (n,), one of each complete run."""
    sample = np.asarray(values, dtype=np.float64)
    given = np.empty((len(sample), 0)) if of_contexts is None else of_contexts
    found = adjusted_mean(sample, given, CONFIDENCE)
    return Estimate(
        found.mean, found.error, len(sample), source, found.adjusted, found.low, found.high
    )


def of_draws(
    values: Mapping[int, float],
    contexts: Mapping[int, Context],
    draws: int,
    space: ContextSpace,
    source: Source,
) -> Estimate:
    """Return the estimate by fresh draws.

    If one failed, the contexts of the others are no sample of their distribution.
    """
    places = sorted(values)
    whole = 0 < len(places) == draws and all(k in contexts for k in places)
    given = covariates(space, [contexts[k] for k in places]) if whole else None
    return of_runs([values[k] for k in places], source, given)
