"""How many evaluations a certificate will probably take, from what a run knows of its result.

Draws of the validation show how often a chance constraint is violated, and the estimate of a worst
case with its noise how far it is from its limit. From these follow the runs after which the
evidence is expected to suffice. What is known of both is little, so the answer is a range.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import betaincinv, ndtr

from bo_tuner.evidence.certificate.economy import FEW, LEAST_DRAWS, is_far
from bo_tuner.evidence.certificate.independent_search import (
    CANDIDATES,
    least_searched,
    most_searched,
)
from bo_tuner.numerics.sequential import draws_needed, log_evidence_of_counts, log_t_evidence
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial

QUARTILES = 0.25, 0.75
"""Of the probability of a violation, after the draws that are known."""

MARGIN = 1.25
"""Factor by which the margin of a worst case may be larger or smaller than estimated."""


@dataclass(frozen=True)
class Outlook:
    """How many evaluations a certificate takes.

    Attributes
    ----------
    low, high
        Of a range that it is probably in.
    """

    low: int
    high: int

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.low}" if self.low == self.high else f"{self.low} to {self.high}"


def outlook(
    study: Study, trial: Trial, drawn: Sequence[Evaluation], most: int, confidence: float
) -> Outlook | None:
    """Return how many evaluations the certificate of a trial probably takes, if it passes.

    Parameters
    ----------
    study
        The study.
    trial
        The trial.
    drawn
        Evaluations of its parameter set in draws, such as those of the validation.
    most
        Largest number of draws, and of runs in a context.
    confidence
        Of each bound.

    Returns
    -------
    Outlook or None
        None if nothing is known of a limit, or if the evidence is of another kind: bets in a
        declared range, or nothing that rests on the models.
    """
    if study.certificate.distribution_free or any(
        study.metrics[constraint.metric].range is not None and not constraint.rule.on_runs
        for constraint in study.constraints.values()
    ):
        return None
    complete = [evaluation for evaluation in drawn if evaluation.outcome.complete]
    draws, needed = [LEAST_DRAWS, LEAST_DRAWS], 0
    places = [0, 0]
    for constraint in study.constraints.values():
        if constraint.rule.in_every_context:
            estimate = trial.worst_cases.get(constraint.name)
            if estimate is None or not estimate.noise > 0.0:
                return None
            margin = constraint.sign * (constraint.limit - estimate.value) / estimate.noise
            for end, factor in enumerate((MARGIN, 1.0 / MARGIN)):
                runs = _runs_in_context(constraint, margin * factor, most, confidence)
                places[end] = max(places[end], runs)
            continue
        if not complete:
            return None
        values = np.array([e.outcome.metrics[constraint.metric] for e in complete])
        if study.worst_case_constraints and is_far(constraint, values):
            needed = max(needed, draws_needed(constraint.allowed, confidence))
            continue
        beyond = int(np.sum(constraint.violations(values)))
        for end, quartile in enumerate(QUARTILES):
            share = betaincinv(beyond + 0.5, len(values) - beyond + 0.5, quartile)
            runs = runs_to_show(float(share), constraint.allowed, most, confidence)
            draws[end] = max(draws[end], runs)
    low, high = draws
    if study.worst_case_constraints:
        space = study.context_space()
        others = CANDIDATES - 1 if study.contexts else 0
        low += least_searched(space, 1) + places[0] + others * FEW
        high += most_searched(space, 1) + 2 * places[1] + others * FEW
    return Outlook(max(low, needed), max(high, needed))


def _runs_in_context(constraint: Constraint, margin: float, most: int, confidence: float) -> int:
    """Return the runs that show a limit in a context, by its margin in deviations of the noise."""
    if not constraint.rule.on_runs:
        return runs_to_show_mean(margin, most, confidence)
    return runs_to_show(float(ndtr(-margin)), constraint.allowed, most, confidence)


def runs_to_show(share: float, allowed: float, most: int, confidence: float) -> int:
    """Return after how many runs with a share beyond a probability is shown; at most `most`."""
    n = np.arange(1.0, most + 1.0)
    shown = log_evidence_of_counts(share * n, n, allowed) >= log(1.0 / (1.0 - confidence))
    return int(np.argmax(shown)) + 1 if share < allowed and shown.any() else most


def runs_to_show_mean(margin: float, most: int, confidence: float) -> int:
    """Return after how many runs a mean is shown to be within a limit; at most `most`.

    Parameters
    ----------
    margin
        From the mean to the limit, in standard deviations of a run.
    most
        Largest number of runs.
    confidence
        Of the bound on the mean.
    """
    enough = log(1.0 / (1.0 - confidence))
    for n in range(FEW, most):
        if log_t_evidence(-margin * float(np.sqrt(n)), n) >= enough:
            return n
    return most
