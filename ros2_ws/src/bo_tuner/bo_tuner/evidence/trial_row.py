"""What a trial shows by its own runs, without models: the row of it, on every screen."""

from dataclasses import dataclass
from enum import StrEnum
from math import nan

from bo_tuner.study.constraint import Constraint
from bo_tuner.study.limits import held_against, uncertain, violated
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Trial, TrialState, Value


class TrialOutcome(StrEnum):
    """Outcome of a trial, as displayed; the rule is that of `study.limits`."""

    WITHIN = "within limits"
    UNCERTAIN = "margin too small"
    VIOLATES = "over the limit"
    OUTLIER = "far off"
    CUT_SHORT = "cut short"
    FAILED = "failed"
    LOST = "lost"
    DISTURBED = "disturbed"
    UNPREPARED = "unprepared"
    WITHDRAWN = "withdrawn"


OF_VALUE = (TrialOutcome.WITHIN, TrialOutcome.UNCERTAIN, TrialOutcome.VIOLATES)
"""Outcomes of trials that say something about their parameters."""


@dataclass(frozen=True)
class TrialLimit:
    """A limit beside the value of a trial that is held against it; NaN without any.

    Attributes
    ----------
    constraint, title
        The limit, and what screens call it.
    value
        The value, in the metric's unit.
    outcome
        Within it, too close to it, or over it.
    """

    constraint: Constraint
    title: str
    value: float
    outcome: TrialOutcome


@dataclass(frozen=True)
class TrialRow:
    """A trial by its own runs.

    Attributes
    ----------
    number
        Its number.
    parameters
        Values of the tuned parameters, in the order of the study; empty texts of those that are
        not active.
    objectives
        Mean of each objective's metric; NaN of a trial that is not complete, or has none.
    limits
        The limits, in the order of the study.
    outcome
        Its outcome.
    reason
        Why it is not complete; empty if it is.
    runs
        Number of its test runs.
    context, seed
        Of the last of these, to repeat it.
    """

    number: int
    parameters: tuple[Value, ...]
    objectives: tuple[float, ...]
    limits: tuple[TrialLimit, ...]
    outcome: TrialOutcome
    reason: str
    runs: int
    context: Context
    seed: int


def outcome_of(study: Study, trial: Trial) -> TrialOutcome:
    """Return the outcome of a trial by its own runs."""
    if trial.state is not TrialState.COMPLETE:
        return TrialOutcome(trial.ending)
    if violated(study, trial):
        return TrialOutcome.VIOLATES
    return TrialOutcome.UNCERTAIN if uncertain(study, trial) else TrialOutcome.WITHIN


def trial_row(study: Study, trial: Trial) -> TrialRow:
    """Return what a trial shows by its own runs."""
    complete, last = trial.state is TrialState.COMPLETE, trial.evaluations[-1]
    shown = study.on_screen(trial.parameters)
    over, close = (violated(study, trial), uncertain(study, trial)) if complete else ((), ())
    means = [trial.mean(each.metric) if complete else None for each in study.objectives]
    return TrialRow(
        number=trial.number,
        parameters=tuple(shown[i.name] for i in study.parameters.values() if i.is_tuned),
        objectives=tuple(nan if mean is None else mean for mean in means),
        limits=tuple(
            TrialLimit(
                limit,
                study.limit_title(limit),
                held_against(limit, trial) if complete else nan,
                _of_limit(name in over, name in close),
            )
            for name, limit in study.constraints.items()
        ),
        outcome=outcome_of(study, trial),
        reason=trial.reason,
        runs=len(trial.evaluations),
        context=last.context,
        seed=last.seed,
    )


def _of_limit(over: bool, close: bool) -> TrialOutcome:
    if over:
        return TrialOutcome.VIOLATES
    return TrialOutcome.UNCERTAIN if close else TrialOutcome.WITHIN
