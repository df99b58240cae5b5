"""Whether the limits of a study hold in evaluations and trials.

The check of candidates, the validation, the record, the report and the displays take the answer
from here; the rules of each kind of limit are in `bo_tuner.study.limit_kinds`.

The certificate and the judge of the benchmark check the same limits with other evidence. Runs in
the worst context estimate whether a limit in every context holds there. Draws from the
distribution of the contexts cannot show such a limit, only refute it, as it must hold in those that
were drawn as well. They refute it if so many violations, or so large a mean, would be a coincidence
of less than 5 %. In a study without contexts all draws are in the only context.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner.codec.rules import Count
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome, ParameterSet, Trial, TrialState, WorstCase


class Standing(StrEnum):
    """What evaluations say of a limit: they show that it is kept, or leave it open, or violate it.

    A limit that a certificate does not show to be kept counts as violated.
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
        How many values may be beyond the limit; None if the limit is on the mean.
    standing
        What the values say of the constraint; `VIOLATED` if there are none.
    """

    name: str
    worst: float
    count: Count
    violations: Count
    permitted: int | None
    standing: Standing

    @property
    def agrees(self) -> bool:
        """Whether the values agree with the constraint; they need not show it."""
        return self.standing is not Standing.VIOLATED


def judge_sample(constraint: Constraint, values: ArrayLike, *, alone: bool = False) -> Sample:
    """Judge a constraint on values (n,) of its metric in draws of context and noise.

    With `alone` all draws are in the only context, which then is the worst one, so that they
    estimate whether a worst-case limit holds.
    """
    sample = np.asarray(values, dtype=np.float64)
    agrees = len(sample) > 0 and constraint.rule.agrees(sample, alone=alone)
    return Sample(
        name=constraint.name,
        worst=constraint.farthest(sample),
        count=len(sample),
        violations=int(np.sum(constraint.violations(sample))),
        permitted=constraint.rule.permitted(len(sample)),
        standing=Standing.OPEN if agrees else Standing.VIOLATED,
    )


def judge_samples(study: Study, evaluations: Sequence[Evaluation]) -> dict[str, Sample]:
    """Judge each constraint, by name, on the complete evaluations among some draws.

    Draws that are all complete, and enough, show a limit on single runs over the contexts.
    """
    complete = [e.outcome.metrics for e in evaluations if e.outcome.complete]
    samples = {
        name: judge_sample(
            constraint,
            [metrics[constraint.metric] for metrics in complete],
            alone=not study.contexts,
        )
        for name, constraint in study.constraints.items()
    }
    if len(complete) < len(evaluations):
        return samples
    return {
        name: replace(sample, standing=Standing.SHOWN) if is_shown(study, sample) else sample
        for name, sample in samples.items()
    }


def is_shown(study: Study, sample: Sample) -> bool:
    """Return whether independent draws show that runs keep a limit as often as they must.

    The confidence is the one that the study asks of a certificate. Draws never show a limit that is
    to hold in every context, unless there is only one.
    """
    rule = study.constraints[sample.name].rule
    if not rule.is_estimated(alone=not study.contexts) or not sample.agrees:
        return False
    return rule.is_shown_by(sample.violations, sample.count, study.certificate.confidence)


def decisive(constraint: Constraint, worst_case: WorstCase) -> float:
    """Return the value of an estimated worst case that is compared with the limit, in its unit.

    For a limit on single runs it is the quantile of a normal metric with the estimated mean and
    noise.
    """
    return worst_case.value + constraint.sign * constraint.deviations * worst_case.noise


def excess(constraint: Constraint, worst_case: WorstCase) -> float:
    """Return how far an estimated worst case is beyond the limit, relative to the limit's size."""
    return constraint.excess(decisive(constraint, worst_case))


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
        Values (n,) of its metric in that context, n ≥ 1. A single one is of a simulator without
        noise.
    """
    # Subtracted before the mean: the mean of equal values may differ from them by rounding.
    beyond = constraint.sign * (np.asarray(values, dtype=np.float64) - constraint.limit)
    if len(beyond) == 1:
        return float(beyond[0]) > 0.0
    mean, noise = float(beyond.mean()), float(beyond.std(ddof=1))
    z = constraint.deviations
    error = noise * math.sqrt((1.0 + 0.5 * z**2) / len(beyond))
    return mean + z * noise - error > 0.0


def broken_limits(study: Study, outcome: Outcome) -> tuple[str, ...]:
    """Return the names of the constraints beyond whose limit a single run is; none if it failed."""
    if not outcome.complete:
        return ()
    return tuple(
        constraint.name
        for constraint in study.constraints.values()
        if constraint.violations(outcome.metrics[constraint.metric])
    )


def is_within_limits(study: Study, trial: Trial) -> bool:
    """Return whether every usable run of a trial was complete and kept all limits.

    False if there is no such run.
    """
    outcomes = [e.outcome for e in trial.evaluations if not e.outcome.unusable]
    return bool(outcomes) and not any(
        broken_limits(study, outcome) or not outcome.complete for outcome in outcomes
    )


def kept_by(study: Study, trials: Sequence[Trial]) -> list[Trial]:
    """Return the trials of parameter sets all runs of which, in all trials, kept the limits.

    The first trial of each parameter set, in the order of the run.
    """
    sets: dict[ParameterSet, list[Trial]] = {}
    for trial in trials:
        if not trial.unusable:
            sets.setdefault(trial.parameter_set, []).append(trial)
    return [
        of_set[0]
        for of_set in sets.values()
        if all(is_within_limits(study, trial) for trial in of_set)
    ]


def violated(study: Study, trial: Trial) -> tuple[str, ...]:
    """Return the names of the constraints that a complete trial violates by its own estimates."""
    broken = []
    for drawn in study.drawn_constraints:
        values = trial.observations(drawn.metric)
        # A trial that ran only in the worst context has no draws, and says nothing of this limit.
        if values and not judge_sample(drawn, values).agrees:
            broken.append(drawn.name)
    for worst in study.worst_case_constraints:
        worst_case = trial.worst_cases.get(worst.name)
        if worst_case is not None and worst.violations(worst_case.value):
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
        if (worst_case := trial.worst_cases.get(worst.name)) is not None
        and not worst.violations(worst_case.value)
        and not worst_case_holds(worst, worst_case)
    )


def held_against(constraint: Constraint, trial: Trial) -> float:
    """Return the value of a complete trial that is compared with a limit; NaN without any.

    The estimated worst case; of a limit over the contexts the mean of the trial's runs, or the
    value that as many of them keep as must keep the limit.
    """
    if (worst := trial.worst_cases.get(constraint.name)) is not None:
        return decisive(constraint, worst)
    values = sorted(trial.observations(constraint.metric), key=lambda v: constraint.sign * v)
    if not values:
        return math.nan
    if not constraint.rule.on_runs:
        return sum(values) / len(values)
    return values[max(math.ceil(constraint.level * len(values) - 1e-9), 1) - 1]


def tightest(study: Study, trial: Trial) -> tuple[Constraint, WorstCase] | None:
    """Return the worst-case constraint that a trial violates most, or keeps with least to spare.

    None without any, or if the trial is not complete.
    """
    pairs = [
        (constraint, trial.worst_cases[constraint.name])
        for constraint in study.worst_case_constraints
        if constraint.name in trial.worst_cases
    ]
    return max(pairs, key=lambda pair: excess(*pair), default=None)


def keeps_limits(study: Study, trial: Trial) -> bool:
    """Return whether a trial is complete, and by its own estimates within all limits."""
    complete = trial.state is TrialState.COMPLETE
    return complete and not violated(study, trial) and not uncertain(study, trial)


def outcome_in_words(study: Study, trial: Trial) -> str:
    """Return the outcome of a trial in files and on topics, with the names of limits.

    For a trial without values it is the `Trial.ending`, such as ``failed`` or ``cut short``.
    """
    if trial.state is not TrialState.COMPLETE:
        return trial.ending
    kinds = {"violates": violated(study, trial), "may violate": uncertain(study, trial)}
    parts = [f"{words} {', '.join(names)}" for words, names in kinds.items() if names]
    return "; ".join(parts) or "within limits"
