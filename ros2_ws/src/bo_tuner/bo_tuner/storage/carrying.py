"""Trials of an earlier run that a new run of the same study begins with."""

import dataclasses
from collections.abc import Sequence

from bo_tuner.storage.journal_reader import JournalContent
from bo_tuner.trials import Trial

ORIGIN = "from"
"""Key of an evaluation's details that names the run it comes from."""


def carried_over(trials: Sequence[Trial], run: str) -> JournalContent:
    """Return what a journal begins with that has the trials of another run.

    Parameters
    ----------
    trials
        The whole trials of that run.
    run
        Its folder, which trials and evaluations name as their origin; what was carried over before
        keeps the first one.
    """
    carried = []
    for trial in trials:
        known = trial.evaluations[0].outcome.details.get(ORIGIN) if trial.evaluations else None
        if known is not None:
            carried.append(trial)
            continue
        evaluations = tuple(
            dataclasses.replace(
                evaluation,
                outcome=dataclasses.replace(
                    evaluation.outcome, details={**evaluation.outcome.details, ORIGIN: run}
                ),
            )
            for evaluation in trial.evaluations
        )
        origin = f"{trial.origin} ({ORIGIN} {run})"
        carried.append(dataclasses.replace(trial, origin=origin, evaluations=evaluations))
    every = tuple(evaluation for trial in carried for evaluation in trial.evaluations)
    return JournalContent((), tuple(carried), every, "")
