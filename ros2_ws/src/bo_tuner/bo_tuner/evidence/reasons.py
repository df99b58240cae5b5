"""Why a certificate shows a limit, or does not: kinds and numbers, without a sentence.

`bo_tuner.evidence.words.certificate` has the words.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import nan


class Why(StrEnum):
    """What decides a limit, or leaves it open."""

    SHARE = "share of test runs"
    MEAN = "mean of test runs"
    TWO_KINDS = "test runs of two kinds"
    WITHOUT_NOISE = "test runs without noise"
    EARLIER = "earlier test runs"
    DRAWS = "too many test runs beyond"
    NOT_RUN = "worst contexts not run"
    FAILED = "failed in worst contexts"
    EARLIER_IN_CONTEXT = "earlier runs in a context"
    SHARE_IN_CONTEXT = "share in worst context"
    MEAN_IN_CONTEXT = "mean in worst context"
    REFUTED_IN_CONTEXT = "mean refuted in a context"
    TWO_KINDS_IN_CONTEXT = "two kinds in a context"


@dataclass(frozen=True)
class Reason:
    """Why a limit is shown or not, with the numbers that its findings do not have.

    Attributes
    ----------
    why
        What decides.
    needed
        Fewest draws that show a share, none of them beyond the limit.
    bound
        Confidence bound of the mean over draws; not finite if these are too few.
    earlier, together
        Number of earlier draws, and what is limited in these and the fresh ones together.
    place
        Place, among the worst contexts of the findings, of the one that decides.
    not_run
        Number of contexts that may be the worst and had no run.
    """

    why: Why
    needed: int = 0
    bound: float = nan
    earlier: int = 0
    together: float = nan
    place: int = 0
    not_run: int = 0


@dataclass(frozen=True)
class Assumption:
    """What a limit rests on beside the runs that are counted.

    Attributes
    ----------
    title
        What screens call the limited metric.
    repeats
        Where runs are declared free of noise: how many were made once more, with the same result;
        None where the noise is said to have no rare second kind of runs.
    """

    title: str
    repeats: int | None = None
