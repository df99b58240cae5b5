"""Whether a limit holds: the one place that says so of evaluations and of trials.

What `recommend`, `validate`, the record, the report and the screens say of a limit comes from here;
the certificate adds confidence bounds to the same counts.
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
    """Values of a constrained metric in draws of context and noise.

    Attributes
    ----------
    name
        Of the constraint.
    worst
        The largest value; NaN without any.
    count, violations
        Number of values, and of those above the limit.
    holds
        Whether no more of them violate the limit than the constraint allows; False without any.
    """

    name: str
    worst: float
    count: int
    violations: int
    holds: bool


def most_violations(constraint: Constraint, count: int) -> int:
    """Return how many of `count` draws may exceed the limit.

    The share that a chance constraint allows, 1 - probability, has a rounding error; a draw is not
    to be refused for it.
    """
    return math.floor(constraint.allowed * count + 1e-9)


def judge_sample(constraint: Constraint, values: ArrayLike) -> Sample:
    """Judge values (n,) of the constrained metric in draws from the contexts' distribution."""
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
    """Judge every constraint on the complete ones among some draws, by the constraints' names."""
    complete = [
        e.outcome.metrics for e in evaluations if e.outcome.state is EvaluationState.COMPLETE
    ]
    return {
        name: judge_sample(constraint, [metrics[constraint.metric] for metrics in complete])
        for name, constraint in study.constraints.items()
    }


def worst_case_holds(constraint: Constraint, worst_case: WorstCase) -> bool:
    """Whether the estimate of a worst case is within the limit, in expectation over noise."""
    return worst_case.value <= constraint.upper


def refuted(constraint: Constraint, values: ArrayLike) -> bool:
    """Whether evaluations of one context show that a single one exceeds the limit too often.

    Refuted is what violates by more than the error of the estimate mean + z noise, z being the
    quantile of the constraint's probability.

    Parameters
    ----------
    constraint
        A worst-case constraint.
    values
        Values (n,) of its metric in that context; two at least.
    """
    found = np.asarray(values, dtype=np.float64)
    mean, noise = float(found.mean()), float(found.std(ddof=1))
    z = constraint.deviations
    error = noise * math.sqrt((1.0 + 0.5 * z**2) / len(found))
    return mean + z * noise - error > constraint.upper


def violated(study: Study, trial: Trial) -> tuple[str, ...]:
    """Return the names of the constraints that what was seen of a complete trial violates."""
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
    """Say in a few words whether what was seen of a trial keeps the limits."""
    if trial.state is TrialState.FAILED:
        return FAILED
    broken = violated(study, trial)
    return f"violates {', '.join(broken)}" if broken else WITHIN


def all_hold(samples: Mapping[str, Sample]) -> bool:
    """Whether every constraint holds."""
    return all(sample.holds for sample in samples.values())
