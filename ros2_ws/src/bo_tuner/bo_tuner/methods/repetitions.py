"""Trials that are run again: how many evaluations check a candidate, and what is on record."""

from collections.abc import Iterable

from bo_tuner.study.study import Study
from bo_tuner.trials import CHECKS, Evaluation, latest_by_place

DRAWN_EVALUATIONS = 10
WORST_EVALUATIONS = 10


def most_check_evaluations(study: Study) -> int:
    """Return the largest number of evaluations in the check of a candidate."""
    return DRAWN_EVALUATIONS + worst_evaluations(study) * len(study.worst_case_constraints)


def worst_evaluations(study: Study) -> int:
    """Return the number of evaluations of a check in each worst context."""
    return 1 if study.is_noiseless else WORST_EVALUATIONS


def repetitions_of(evaluations: Iterable[Evaluation]) -> dict[int, list[Evaluation]]:
    """Return the evaluations on record that checked trials, by number of the trial."""
    by_trial = latest_by_place(evaluations, CHECKS)
    return {trial: list(checks.values()) for trial, checks in by_trial.items()}
