"""Whether the limits of a study hold in evaluations and trials.

The check of candidates, the validation, the record, the report and the displays take the answer
from here. A limit is one of three:

chance
    Over contexts and noise, a run keeps it with at least the constraint's `probability`.
worst case, with a `probability`
    In every context a run keeps it with at least that probability (`SINGLE_RUN`).
worst case, without
    In every context the mean over noise keeps it (`EXPECTATION`).

The certificate and the judge of the benchmark ask for the same; they differ in the evidence. What
is observed in the worst context estimates whether a worst-case limit holds there. Draws from the
distribution of the contexts cannot show it, only refute it: what holds in every context holds in
those that were drawn. They do where so many violations, or so large a mean, would be a coincidence
of less than `COINCIDENCE`. In a study without contexts the draws are of the only one there is.

References
----------
Clopper and Pearson (1934). The use of confidence or fiducial limits illustrated in the case of the
binomial. Biometrika 26(4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtr, bdtrc, stdtrit

from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import CHANCE, EXPECTATION, WORST_CASE, Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState, WorstCase

WITHIN = "within limits"

COINCIDENCE = 0.05
"""Probability below which draws refute a worst-case limit."""


class Standing(StrEnum):
    """What evaluations say of a limit: they show that it is kept, or leave it open, or violate it.

    One that a certificate does not show to be kept counts as violated.
    """

    SHOWN = "shown"
    OPEN = "open"
    VIOLATED = "violated"


@dataclass(frozen=True)
class Sample:
    """A constraint judged on draws of context and noise.

    Attributes
    ----------
    name
        Name of the constraint.
    worst
        Value of its metric that is farthest on the side of the limit, in the metric's unit; NaN if
        there are no values.
    count, violations
        Number of values, and of those beyond the limit.
    permitted
        How many of them may be, see `permitted_violations`; None if the limit is on the mean.
    standing
        What the values say of the constraint; `VIOLATED` if there are none.
    """

    name: str
    worst: float
    count: int
    violations: int
    permitted: int | None
    standing: Standing

    @property
    def agrees(self) -> bool:
        """Whether the values agree with the constraint, which need not show it."""
        return self.standing is not Standing.VIOLATED


def permitted_violations(constraint: Constraint, count: int) -> int | None:
    """Return how many of `count` runs a limit on single runs permits beyond it; None on the mean.

    It is floor((1 - probability) count); the tolerance of 1e-9 compensates for the rounding of
    1 - probability.
    """
    if constraint.statistic == EXPECTATION:
        return None
    return math.floor(constraint.allowed * count + 1e-9)


def most_violations(constraint: Constraint, count: int, *, alone: bool = False) -> int:
    """Return how many of `count` draws may violate the limit before they refute it.

    They are the `permitted_violations` of a chance constraint, and, with `alone`, of a worst-case
    one on single runs. Otherwise it is for the latter the largest k with P(X >= k) >= `COINCIDENCE`
    for X ~ Binomial(count, 1 - probability). One on the mean over noise permits any number.
    """
    permitted = permitted_violations(constraint, count)
    if permitted is None:
        return count
    if constraint.kind == WORST_CASE and not alone:
        above = np.arange(1, count + 1)
        return int(np.sum(bdtrc(above - 1, count, constraint.allowed) >= COINCIDENCE))
    return permitted


def judge_sample(constraint: Constraint, values: ArrayLike, *, alone: bool = False) -> Sample:
    """Judge a constraint on values (n,) of its metric in draws of context and noise.

    With `alone` there is no context but that of the draws: they are of the worst one, and estimate
    whether a worst-case limit holds there.
    """
    found = np.asarray(values, dtype=np.float64)
    violations = int(np.sum(constraint.violations(found)))
    agrees = len(found) > 0 and violations <= most_violations(constraint, len(found), alone=alone)
    if agrees and constraint.statistic == EXPECTATION:
        # From the limit, as the mean of equal values may differ from them by rounding.
        beyond = constraint.sign * (found - constraint.limit)
        agrees = (float(beyond.mean()) if alone else _lowest_mean(beyond)) <= 0.0
    return Sample(
        name=constraint.name,
        worst=constraint.farthest(found),
        count=len(found),
        violations=violations,
        permitted=permitted_violations(constraint, len(found)),
        standing=Standing.OPEN if agrees else Standing.VIOLATED,
    )


def judge_samples(study: Study, evaluations: Sequence[Evaluation]) -> dict[str, Sample]:
    """Judge each constraint, by name, on the complete evaluations among some draws.

    Draws that are all complete, and enough, show a limit on single runs over the contexts.
    """
    complete = [e.outcome.metrics for e in evaluations if e.outcome.complete]
    found = {
        name: judge_sample(
            constraint,
            [metrics[constraint.metric] for metrics in complete],
            alone=not study.contexts,
        )
        for name, constraint in study.constraints.items()
    }
    if len(complete) < len(evaluations):
        return found
    return {
        name: replace(sample, standing=Standing.SHOWN) if is_shown(study, sample) else sample
        for name, sample in found.items()
    }


def is_shown(study: Study, sample: Sample) -> bool:
    """Return whether independent draws show that runs keep a limit as often as they must.

    They do if the upper confidence bound of the probability of a violation, at the confidence that
    the study asks of a certificate, is at most the one that is allowed (Clopper and Pearson 1934):
    P(X <= violations) <= 1 - confidence for X ~ Binomial(count, allowed). Draws never show what is
    to hold in every context, unless there is but one, and this bound is none of a mean.
    """
    constraint = study.constraints[sample.name]
    over_draws = constraint.kind == CHANCE or not study.contexts
    if not over_draws or constraint.statistic == EXPECTATION or not sample.agrees:
        return False
    luck = float(bdtr(sample.violations, sample.count, constraint.allowed))
    return luck <= 1.0 - study.certificate.confidence


def excess(constraint: Constraint, worst_case: WorstCase) -> float:
    """Return how far an estimated worst case is beyond the limit, as `Constraint.excess`.

    On single runs it is the quantile of a normal metric with the estimated mean and noise.
    """
    deviation = constraint.deviations * worst_case.noise
    return constraint.excess(worst_case.value + constraint.sign * deviation)


def worst_case_holds(constraint: Constraint, worst_case: WorstCase) -> bool:
    """Return whether an estimated worst case keeps the limit."""
    return excess(constraint, worst_case) <= 0.0


def refuted(constraint: Constraint, values: ArrayLike) -> bool:
    """Return whether repeated evaluations of one context refute a worst-case constraint.

    A single evaluation stays below mean + z s with the constraint's probability, where s is the
    standard deviation and z = Φ⁻¹(probability); z = 0 if the limit is on the mean. The constraint
    is refuted if this quantile exceeds the limit by more than its standard error,
    s √((1 + z² / 2) / n). For a lower limit it is the mirror image.

    Parameters
    ----------
    constraint
        A worst-case constraint.
    values
        Values (n,) of its metric in that context, n ≥ 2.
    """
    # From the limit, as the mean of equal values may differ from them by rounding.
    found = constraint.sign * (np.asarray(values, dtype=np.float64) - constraint.limit)
    mean, noise = float(found.mean()), float(found.std(ddof=1))
    z = constraint.deviations
    error = noise * math.sqrt((1.0 + 0.5 * z**2) / len(found))
    return mean + z * noise - error > 0.0


def violated(study: Study, trial: Trial) -> tuple[str, ...]:
    """Return the names of the constraints that a complete trial violates by its own estimates."""
    broken = []
    for chance in study.chance_constraints:
        values = trial.observations(chance.metric)
        # A repetition in the worst context alone has none, and says nothing of this limit.
        if values and not judge_sample(chance, values).agrees:
            broken.append(chance.name)
    for worst in study.worst_case_constraints:
        found = trial.worst_cases.get(worst.name)
        if found is not None and worst.violations(found.value):
            broken.append(worst.name)
    return tuple(broken)


def uncertain(study: Study, trial: Trial) -> tuple[str, ...]:
    """Return the names of the constraints that a complete trial may violate.

    Its mean in the worst context keeps the limit, but is too close to it for single runs to keep it
    as often as they must.
    """
    return tuple(
        worst.name
        for worst in study.worst_case_constraints
        if (found := trial.worst_cases.get(worst.name)) is not None
        and not worst.violations(found.value)
        and not worst_case_holds(worst, found)
    )


def tightest(study: Study, trial: Trial) -> tuple[Constraint, WorstCase] | None:
    """Return the worst-case constraint that a trial violates most, or keeps with least to spare.

    None without any, or if the trial is not complete.
    """
    found = [
        (constraint, trial.worst_cases[constraint.name])
        for constraint in study.worst_case_constraints
        if constraint.name in trial.worst_cases
    ]
    return max(found, key=lambda pair: excess(*pair), default=None)


def outcome_in_words(study: Study, trial: Trial) -> str:
    """Return what a trial is called: `WITHIN`, or the limits that it violates, or may violate.

    One without values is called by its `Trial.ending`, such as ``failed`` or ``lost``.
    """
    if trial.state is TrialState.FAILED:
        return trial.ending
    kinds = {"violates": violated(study, trial), "may violate": uncertain(study, trial)}
    found = [f"{kind} {', '.join(names)}" for kind, names in kinds.items() if names]
    return "; ".join(found) or WITHIN


def _lowest_mean(values: Array) -> float:
    """Return the mean (Student's t) below which that of values (n,) is by `COINCIDENCE` only."""
    count = len(values)
    if count < 2:
        return -math.inf
    error = float(values.std(ddof=1)) / math.sqrt(count)
    return float(values.mean()) - float(stdtrit(count - 1, 1.0 - COINCIDENCE)) * error
