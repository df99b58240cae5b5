"""How a row divides its evaluations between the trials and the search for the answer.

Optimizers are compared at equally many evaluations in all: what one runs for its answer, its trials
lack.
"""

import dataclasses
import math

from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.boundary.settling import Repetitions
from bo_tuner.methods.boundary.stage_one import new_point
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.repetitions import most_check_evaluations
from bo_tuner.study.study import Study
from tuning_benchmark.paper.method import PaperMethod


def divided(method: Method, study: Study, evaluations: int, reserved: int) -> tuple[Method, int]:
    """Divide the evaluations of a run between its trials and its checks.

    Parameters
    ----------
    method, study
        Of the run.
    evaluations
        All together.
    reserved
        Part of them that is kept for a method that checks candidates.

    Returns
    -------
    Method
        With as many checks as the evaluations allow.
    int
        Evaluations of the trials.
    """
    match method:
        case Boundary():
            return method, before_repetitions(method.repetitions, study, evaluations)
        case PaperMethod():
            # As many checks as the reserved evaluations allow.
            most = min(method.check.most, reserved // most_check_evaluations(study))
            check = dataclasses.replace(method.check, most=most)
            return dataclasses.replace(method, check=check), evaluations - (reserved if most else 0)
        case _:
            return method, evaluations


def before_repetitions(repetitions: Repetitions, study: Study, evaluations: int) -> int:
    """Return how many of all evaluations are those of the trials, at least one."""
    if not repetitions.share:
        return evaluations
    of_trials = _part_of_trials(repetitions, evaluations)
    return max(1, min(evaluations - most_check_evaluations(study), of_trials))


def further_trials(method: Method, study: Study, left: int) -> int:
    """Return how many of the evaluations `left` after the answer go to more trials.

    No check is kept in reserve, since an answer is known; 0 if they are too few for a trial.
    """
    if not isinstance(method, Boundary):
        return 0
    more = _part_of_trials(method.repetitions, left)
    return more if more >= sum(new_point(study)) else 0


def reserve_in_words(method: Method, reserved: int) -> str:
    """Return what a method keeps of the evaluations; see `divided`."""
    match method:
        case Boundary():
            return (
                "boundary keeps part of them for repetitions, and goes on with further trials when "
                "these settle the answer early"
            )
        case PaperMethod():
            return (
                "algorithms that check their candidates before they answer reserve "
                f"{reserved} of them for the checks"
            )
        case _:
            return ""


def _part_of_trials(repetitions: Repetitions, evaluations: int) -> int:
    """Return how many evaluations are of trials, with repetitions in proportion."""
    return math.floor(evaluations / (1.0 + repetitions.share))
