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

from bo_tuner.study.limits import is_within_limits
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial

FIRST = 0.25
"""Trust before the first trial: little is known of how far an effect goes."""

IN_A_ROW = 3
"""Trials in a row, all within the limits, that double the trust."""


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
