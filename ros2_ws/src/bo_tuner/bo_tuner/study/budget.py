"""What a run may take: its trials and evaluations, and the test runs of its certificate."""

import math
from dataclasses import dataclass
from typing import Annotated

from bo_tuner import maxima
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import FRACTION, Whole


@dataclass(frozen=True, kw_only=True)
class CertificateRequirement(Section):
    """What a certificate must have for `apply`, at least.

    Attributes
    ----------
    draws : int
        Fresh test runs in random contexts, at most, and in a context that may be the worst; a
        clear verdict takes fewer. More where a chance constraint takes more to be shown.
    confidence : float
        Confidence over all certificates of a run together, between 0 and 1; each bound has a
        higher one.
    distribution_free : bool
        Whether a PASS must rest on nothing but counts of runs and declared ranges of metrics. Each
        limit on a mean then needs a metric with a `range`.
    """

    draws: Annotated[int, Whole(2, maxima.TEST_RUNS)] = 1000
    confidence: Annotated[float, FRACTION] = 0.95
    distribution_free: bool = False


@dataclass(frozen=True, kw_only=True)
class Budget(Section):
    """Number of trials and evaluations.

    Attributes
    ----------
    trials : int
        Trials, each of one parameter set, including the initial design.
    initial_trials : int
        Number of trials in the initial design, at most `trials`.
    drawn_contexts : int, optional
        Evaluations per trial in contexts drawn from their distribution. Unless given, the
        algorithm's: 5, or 2 for boundary; without contexts and noise 1.
    search_evaluations : int, optional
        Largest number of evaluations per trial in the search for the worst context, for all
        worst-case constraints together. Unless given, the algorithm's: 10, or 3 for boundary.
    validation_draws : int
        Fresh test runs, in random contexts, for the validation of the result.
    evaluations : int, optional
        Evaluations of all trials together; the tuning also ends with the trial that reaches it.
    workers : int, optional
        Evaluations that run at once, each on nodes or objects of its own in a process of its own.
        Unless given, 1.
    cut_short : bool
        Whether a run of a trial ends as soon as its outcome is decided, by a metric that only
        grows.
    """

    trials: Annotated[int, Whole(1, maxima.TRIALS)]
    initial_trials: Annotated[int, Whole(1, maxima.TRIALS)]
    drawn_contexts: Annotated[int, Whole(1, maxima.EVALUATIONS)] | None = None
    search_evaluations: Annotated[int, Whole(0, maxima.EVALUATIONS)] | None = None
    validation_draws: Annotated[int, Whole(1, maxima.TEST_RUNS)] = 25
    evaluations: Annotated[int, Whole(1, maxima.TRIALS * maxima.EVALUATIONS)] | None = None
    workers: Annotated[int, Whole(1, maxima.WORKERS)] | None = None
    cut_short: bool = False

    def remaining(self, trials: int, evaluations: int) -> int:
        """Return how many trials are left of the budget, after so many trials and evaluations.

        Where evaluations limit it, further trials are expected to take as many each as the others.
        """
        left = self.trials - trials
        if self.evaluations is not None:
            each = max(evaluations, 1) / max(trials, 1)
            left = min(left, math.ceil((self.evaluations - evaluations) / each))
        return max(left, 0)

    @property
    def warning(self) -> str:
        """Return in a line that no trial is left after the initial design; empty if some are."""
        if self.initial_trials < self.trials:
            return ""
        all_of_them = "the only trial" if self.trials == 1 else f"all of the {self.trials} trials"
        return f"the initial design takes {all_of_them}; none is proposed"

    def part_spent(self, trials: int, evaluations: int) -> float:
        """Return the part of the budget that so many trials and evaluations have used."""
        parts = [trials / self.trials]
        if self.evaluations is not None:
            parts.append(evaluations / self.evaluations)
        return max(parts)

    def is_spent(self, trials: int, evaluations: int) -> bool:
        """Return whether so many trials, with so many evaluations, use up the budget."""
        return self.remaining(trials, evaluations) == 0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "initial_trials", min(self.initial_trials, self.trials))
