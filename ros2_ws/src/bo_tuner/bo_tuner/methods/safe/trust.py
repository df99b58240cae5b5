"""What trials have shown of the limits, and how far the models are trusted after it.

The trust is a factor of the largest step and of the risk that a study permits. It begins at
`FIRST`. Each trial in which a run breaks a limit, or fails for its parameters, halves it; each
`IN_A_ROW` trials in a row in which none does double it, up to 1. A trust region shrinks and grows
by the same rule (TuRBO, Eriksson et al. 2019, Sec. 3: half the edges after failures, twice after
three successes in a row), which Xopt applies to a machine's limits (its SafetyTurboController).

References
----------
Eriksson, Pearce, Gardner, Turner and Poloczek (2019). Scalable global optimization via local
Bayesian optimization. NeurIPS 32.
"""

from collections.abc import Sequence

from bo_tuner.study.limits import broken_limits
from bo_tuner.study.study import Study
from bo_tuner.trials import ParameterSet, Trial

FIRST = 0.25
"""Trust before the first trial: little is known of how far an effect goes."""

IN_A_ROW = 3
"""Trials in a row, all within the limits, that double the trust."""


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


def trust_after(study: Study, trials: Sequence[Trial]) -> float:
    """Return the trust after trials, as the module says."""
    trust, in_a_row = FIRST, 0
    for trial in trials:
        if trial.unusable:
            continue
        if is_within_limits(study, trial):
            in_a_row += 1
            if in_a_row == IN_A_ROW:
                trust, in_a_row = min(2.0 * trust, 1.0), 0
        else:
            trust, in_a_row = 0.5 * trust, 0
    return trust
