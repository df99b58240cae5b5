"""How large a budget a study needs, by its number of parameters, contexts and kinds of limits."""

from collections.abc import Iterator
from dataclasses import dataclass

from bo_tuner.study.study import Study

OF_PARAMETER = 10
"""Trials for each parameter (Loeppky, Sacks and Welch 2009, sec. 3), and once more as many."""
FEW = 0.5
"""Share of these trials below which they are said to be few."""
DRAWN = 2
"""Drawn contexts of a trial where its runs differ, and a limit asks by how much."""


@dataclass(frozen=True)
class FewTrials:
    """Trials are few for a number of tuned parameters, beside as many as usual."""

    trials: int
    parameters: int
    usual: int


@dataclass(frozen=True)
class FewContexts:
    """A trial has one drawn context, which says little of them."""


def usual_trials(parameters: int) -> int:
    """Return the usual number of trials for a number of tuned parameters."""
    return OF_PARAMETER * (parameters + 1)


def first_budget(parameters: int, *, contexts: bool, limits_runs: bool) -> dict[str, int]:
    """Return the budget of a first study.

    Parameters
    ----------
    parameters
        Number of tuned parameters.
    contexts
        Whether the machine may differ from run to run.
    limits_runs
        Whether a limit is on single runs, or on the worst context.
    """
    return {
        "trials": usual_trials(parameters),
        "initial_trials": max(8, 2 * (parameters + 1)),
        "drawn_contexts": DRAWN if contexts or limits_runs else 1,
        "validation_draws": 5,
    }


def shortages(study: Study) -> Iterator[FewTrials | FewContexts]:
    """Yield what is too small of a study's budget."""
    budget, tuned = study.budget, len(study.search_space().names)
    usual = usual_trials(tuned)
    if budget.trials < FEW * usual:
        yield FewTrials(budget.trials, tuned, usual)
    if budget.drawn_contexts == 1 and study.contexts:
        yield FewContexts()
