"""Whether the limits of a study hold in evaluations and trials.

`recommend`, `validate`, the record, the report and the displays take the answer from here; the
certificate judges by confidence bounds instead.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.study.parts import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Trial, TrialState, WorstCase

FAILED, WITHIN = "failed", "within limits"


@dataclass(frozen=True)
class Sample:
    """A constraint judged on draws of context and noise.

    Attributes
    ----------
    name
        Name of the constraint.
    worst
        Largest value of its metric, in the metric's unit; NaN if there are no values.
    count, violations
        Number of values, and of those above the limit.
    holds
        Whether at most `most_violations` values exceed the limit; False if there are no values.
    """

    name: str
    worst: float
    count: int
    violations: int
    holds: bool


def most_violations(constraint: Constraint, count: int) -> int:
    """Return how many of `count` draws may exceed the limit.

    The result is floor((1 - probability) count) for a chance constraint, and 0 for a worst-case
    one; the tolerance of 1e-9 compensates for the rounding of 1 - probability.
    """
    return math.floor(constraint.allowed * count + 1e-9)


def judge_sample(constraint: Constraint, values: ArrayLike) -> Sample:
    """Judge a constraint on values (n,) of its metric in draws of context and noise."""
    found = np.asarray(values, dtype=np.float64)
    violations = int(np.sum(found > constraint.upper))
    return Sample(
        name=constraint.name,
        worst=float(found.max()) if len(found) else math.nan,
        count=len(found),
        violations=violations,
        holds=len(found) > 0 and violations <= most_violations(constraint, len(found)),
    )


def judge_samples(study: Study, evaluations: Sequence[Evaluation]) -> dict[str, Sample]:
    """Judge each constraint, by name, on the complete evaluations among some draws."""
    complete = [
        e.outcome.metrics for e in evaluations if e.outcome.state is EvaluationState.COMPLETE
    ]
    return {
        name: judge_sample(constraint, [metrics[constraint.metric] for metrics in complete])
        for name, constraint in study.constraints.items()
    }


def worst_case_holds(constraint: Constraint, worst_case: WorstCase) -> bool:
    """Return whether the estimated worst case, an expectation over noise, is within the limit."""
    return worst_case.value <= constraint.upper


def refuted(constraint: Constraint, values: ArrayLike) -> bool:
    """Return whether repeated evaluations of one context refute a worst-case constraint.

    A single evaluation stays below mean + z s with the constraint's probability, where s is the
    standard deviation and z = Φ⁻¹(probability). The constraint is refuted if this quantile exceeds
    the limit by more than its standard error, s √((1 + z² / 2) / n).

    Parameters
    ----------
    constraint
        A worst-case constraint.
    values
        Values (n,) of its metric in that context, n ≥ 2.
    """
    found = np.asarray(values, dtype=np.float64)
    mean, noise = float(found.mean()), float(found.std(ddof=1))
    z = constraint.deviations
    error = noise * math.sqrt((1.0 + 0.5 * z**2) / len(found))
    return mean + z * noise - error > constraint.upper


def violated(study: Study, trial: Trial) -> tuple[str, ...]:
    """Return the names of the constraints that a complete trial violates."""
    broken = []
    for chance in study.chance_constraints:
        if not judge_sample(chance, trial.observations(chance.metric)).holds:
            broken.append(chance.name)
    worst = study.worst_case_constraint
    if (
        worst is not None
        and trial.worst_case is not None
        and not worst_case_holds(worst, trial.worst_case)
    ):
        broken.append(worst.name)
    return tuple(broken)


def verdict(study: Study, trial: Trial) -> str:
    """Return `FAILED`, `WITHIN`, or ``violates`` with the names of the violated constraints."""
    if trial.state is TrialState.FAILED:
        return FAILED
    broken = violated(study, trial)
    return f"violates {', '.join(broken)}" if broken else WITHIN


def all_hold(samples: Mapping[str, Sample]) -> bool:
    """Whether every constraint holds."""
    return all(sample.holds for sample in samples.values())
